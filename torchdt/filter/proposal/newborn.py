"""Proposals for new objects, around the picks of a search."""

import math

import torch
from torch import Tensor

from torchdt.field.base import Field
from torchdt.filter.bp.messages import state_message
from torchdt.filter.bp.moments import signal_without_each
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.base import Proposal
from torchdt.filter.proposal.moved import Draws, respond
from torchdt.filter.proposal.neighbourhood import drop_foreign, log_cells
from torchdt.filter.proposal.search import Picks
from torchdt.filter.state import Objects
from torchdt.model.existence import drop_outside
from torchdt.model.measurement import Measurement
from torchdt.model.model import Model
from torchdt.model.noise.base import Noise, NoiseCovariance
from torchdt.model.region import Region

ADAPTED = Adapted()


def _beside(odds: Tensor, others: Tensor) -> Tensor:
    """Log-odds `(*batch, S)` beside those of a pick, `(*batch,)`; alike where none is born at the pick."""
    there = ~odds.isneginf()
    return torch.where(there[..., None], others - torch.where(there, odds, 0.0)[..., None], 0.0)


def propose_newborn(
    field: Field,
    region: Region,
    measurement: Measurement,
    signal: Tensor,
    picks: Picks,
    noise: Noise,
    power_max: Tensor,
    model: Model,
    power_points: int,
    draws: Draws,
    *,
    proposal: Proposal = ADAPTED,
    noise_model: NoiseCovariance | None = None,
) -> tuple[Objects, Tensor]:
    """New objects around the picks, with particles where prior and likelihood meet.

    The prior is that of births, in position, over a box around the pick, see
    `torchdt.filter.proposal.neighbourhood`; positions come from a proposal fitted to prior times likelihood,
    given the other picks, and are weighted by prior over proposal.

    Args:
        signal: `(*batch, I, M, M)` covariance of the known objects.
        noise: noise belief with known objects and picks explained.
        power_max: `(*batch, I)` upper limit of the powers.
        model: statistical model, for places, powers and states of new objects.
        power_points: number G of their support points.
        draws: at least as many as picks.
        proposal: box of a new object, and density of its particles.
        noise_model: what the noise makes of the covariance of the data; None is that of the model.

    Returns:
        Objects of batch `(*batch, Q)` (log-odds minus infinity where a pick is inactive), whose weights add
        up to the number of cells that their boxes are worth at the odds of the pick, and their responses
        `(*batch, Q, I, P, M)`.
    """
    num = picks.active.shape[-1]
    rounds, final = draws.rounds[..., :num, :, :, :], draws.final[..., :num, :, :]
    maximum = power_max.unsqueeze(-2).expand_as(picks.scale)
    power, log_power_weight = model.power.newborn(picks.scale, maximum, power_points)
    others = signal.unsqueeze(-4) + signal_without_each(picks.power, picks.moment)
    if picks.diffuse is not None:
        others = others + picks.power[..., None, None] * picks.diffuse
    per_pick = measurement.unsqueeze()
    heard = model.noise if noise_model is None else noise_model
    whitener = whiten(per_pick, heard.covariance(others, noise.mean[..., None, :], per_pick.present))

    log_odds = model.birth.log_odds(region, picks.position)

    def beside_pick(position: Tensor) -> Tensor:
        return _beside(log_odds, model.birth.log_odds(region, position))

    def log_likelihood(position: Tensor) -> Tensor:
        message = state_message(whitener, respond(field, position), power, log_power_weight)
        return drop_outside(position, message + beside_pick(position), region)

    prior, density, places = proposal.newborn(log_likelihood, picks.position, region, rounds.movedim(-3, 0))
    d = region.num_coordinates
    position = density.sample(final[..., :d])
    # Of all boxes the odds are those of one cell, so that none goes first for being large; the weights of a
    # box add up to the number of its cells instead.
    log_prior = prior.log_prob(position) + log_cells(prior, region)[..., None] + beside_pick(position)
    log_weight = log_prior - density.log_prob(position) - math.log(final.shape[-2])
    state = model.motion.newborn(region, position, final[..., d:])
    log_weight = drop_outside(state, log_weight, region)
    log_weight = drop_foreign(position, log_weight, places, picks.active, region)
    odds = torch.where(picks.active, log_odds, -torch.inf)
    label = torch.zeros(picks.active.shape, dtype=torch.int64, device=state.device)
    # What is found transmits.
    transmits = torch.ones_like(log_weight)
    objects = Objects(state, log_weight, power, log_power_weight, odds, label, transmits)
    return objects, respond(field, state)
