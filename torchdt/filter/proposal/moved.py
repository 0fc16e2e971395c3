"""Proposals for objects that existed before: the prediction, adapted to the new data."""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.core.importance import Gaussian, adapt
from torchdt.core.mixture import GaussianMixture, deal, of_component
from torchdt.core.trees import put, take, tree_map
from torchdt.core.weights import normalise, weighted_mean
from torchdt.field.base import BaseField, Field
from torchdt.filter.bp.beliefs import Beliefs, as_belief, background, store
from torchdt.filter.bp.messages import object_belief, state_message
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.state import Objects
from torchdt.model.existence import drop_outside
from torchdt.model.measurement import Measurement
from torchdt.model.motion.driving import Gradient, Score
from torchdt.model.noise.base import NoiseCovariance
from torchdt.model.noise.white import WHITE
from torchdt.model.region import Region

SCORE = Score()


class Draws(NamedTuple):
    """Standard normal draws for N objects.

    Attributes:
        rounds: `(*batch, N, rounds, S, d)` for fitting.
        final: `(*batch, N, P, D)` for the particles.
    """

    rounds: Tensor
    final: Tensor


class Drawn(NamedTuple):
    """Drawn particles; constants to any gradient.

    Attributes:
        state: `(*batch, P, D)`.
        component: `(*batch, P)` int64, of the prediction, that each belongs to.
        white: `(*batch, P, D)` the standard normal draws that its component maps to each.
        log_prior: `(*batch, P)` log-density of its component there.
        log_proposal: `(*batch, P)` log of the density of particles of its component, which they add up to
            their number.
    """

    state: Tensor
    component: Tensor
    white: Tensor
    log_prior: Tensor
    log_proposal: Tensor


def respond(field: Field, state: Tensor) -> Tensor:
    """Responses with tones before particles: `(*batch, P, D)` to `(*batch, I, P, M)`."""
    return field(state).transpose(-3, -2)


def sent(response: Tensor, transmits: Tensor) -> Tensor:
    """Responses `(*batch, I, P, M)`, none where particles do not transmit, `(*batch, P)` zero or one."""
    return response if bool(transmits.all()) else response * transmits[..., None, :, None]


def diffuse_part(field: BaseField, state: Tensor, log_weight: Tensor) -> Tensor | None:
    """Diffuse covariance of objects at their mean states, `(*batch, P, D)` to `(*batch, I, M, M)`, if any."""
    return field.diffuse(weighted_mean(state.mT, log_weight[..., None, :]))


def propose_adapted(
    field: Field,
    region: Region,
    predicted: Objects,
    density: GaussianMixture,
    beliefs: Beliefs,
    measurement: Measurement,
    draws: Draws,
    extra_signal: Tensor | None = None,
    *,
    gradient: Gradient = SCORE,
    noise_model: NoiseCovariance = WHITE,
    silent: GaussianMixture | None = None,
) -> tuple[Objects, Tensor, Beliefs]:
    """Redraw the particles of every object where prediction and likelihood meet.

    The prediction of an object is a mixture of Gaussians `w_k N_k`. For each of them positions come from a
    proposal fitted to `N_k(position) * likelihood`, all else from N_k given the position, and the weight is
    `w_k N_k(position) / (n_k proposal_k(position))`, N_k cut off at the edge of the region: the likelihood is
    not part of it. Objects are visited in slot order, each against the newest beliefs of the others.

    Args:
        predicted: objects, batch `(*batch, N)`, strongest first.
        density: of their predicted states, batch `(*batch, N)`.
        beliefs: predicted beliefs of the same objects.
        measurement: statistics of the step.
        draws: random numbers.
        extra_signal: `(*batch, I, M, M)` covariance of signals that are no objects yet.
        gradient: how the particles depend on the prediction.
        noise_model: what the noise makes of the covariance of the data.
        silent: what `density` is of objects that do not transmit; their particles are as predicted.

    Returns:
        The objects with new particles; their responses `(*batch, N, I, P, M)`; beliefs after this first
        sequential sweep.
    """
    transmitting, density = density.mean.shape[-2], density.joined(silent)
    log_inside = _log_inside(region, density, draws.rounds, gradient)
    states, log_weights, responses, objects = [], [], [], predicted
    num_objects = predicted.log_odds.shape[-1]
    for slot in range(num_objects):
        index = torch.full_like(predicted.label[..., 0], slot)
        whitener = whiten(measurement, background(beliefs, measurement, index, extra_signal, noise_model))
        slot_prior = tree_map(partial(take, index=index), as_belief(predicted))
        power = take(predicted.power, index)

        def log_likelihood(state: Tensor) -> Tensor:
            return state_message(whitener, respond(field, state), power, slot_prior.log_power_weight)  # noqa: B023

        prediction = GaussianMixture(*(take(t, index) for t in density))
        normal = take(draws.rounds, index), take(draws.final, index)
        drawn = draw_adapted(log_likelihood, prediction, *normal, transmitting)
        component = drawn.component

        def log_density(state: Tensor) -> Tensor:
            """Of particles in their components."""
            return prediction.log_prob(state, component) - prediction.log_share(component)  # noqa: B023

        moving = prediction.sample(drawn.white, component)
        state, log_ratio = gradient.attach(drawn.state, moving, log_density, drawn.log_prior)
        # Which component a particle belongs to does not move with the parameters.
        log_prior = drawn.log_prior + log_ratio + prediction.log_share(component)
        log_weight = log_prior - drawn.log_proposal
        # Given that the object is still in the region; that it left is in the predicted existence.
        log_weight = drop_outside(state, log_weight, region) - take(log_inside, index)[..., None]
        transmits = (component < transmitting).to(log_weight)
        response = sent(respond(field, state), transmits)
        belief = object_belief(whitener, response, power, slot_prior._replace(log_weight=log_weight))
        objects = objects._replace(transmits=put(objects.transmits, index, transmits))
        beliefs = store(beliefs, index, belief, objects, response)
        states.append(state)
        log_weights.append(log_weight)
        responses.append(response)
    batch_dims = predicted.log_odds.ndim - 1
    objects = objects._replace(
        state=torch.stack(states, batch_dims), log_weight=torch.stack(log_weights, batch_dims)
    )
    return objects, torch.stack(responses, batch_dims), beliefs


def _log_inside(region: Region, density: GaussianMixture, rounds: Tensor, gradient: Gradient) -> Tensor:
    """Log of the share of predictions that lies in the region, `(*batch, N)`, by sampling their components.

    Zero where all samples are inside. The samples stay where they are, and their log-ratio is all that has a
    gradient: particles that move have none where they cross the edge of the region, and here neither.
    """
    predicted = density.marginal(region.num_coordinates).components
    rounds = rounds[..., : density.mean.shape[-3], :, :, :]
    position = predicted.sample(rounds.flatten(-3, -2).unsqueeze(-3)).detach()
    # The region may differ from sequence to sequence, not from component to component.
    inside = region.contains(position.flatten(-3, -2)).unflatten(-1, position.shape[-3:-1])
    _, log_ratio = gradient.attach(position, position, predicted.log_prob)
    num = position.shape[-2]
    # As if one sample more were inside where none is.
    total = torch.where(inside, log_ratio, -torch.inf).exp().sum(-1).clamp_min(1.0)
    log_inside = (density.log_weight + total.log() - math.log(num)).logsumexp(-1)
    return torch.where(inside.all((-2, -1)), 0.0, log_inside)


@torch.no_grad()
def draw_adapted(
    log_likelihood: Callable[[Tensor], Tensor],
    predicted: GaussianMixture,
    rounds: Tensor,
    final: Tensor,
    transmitting: int,
) -> Drawn:
    """Particles where a predicted mixture and a likelihood meet.

    Args:
        log_likelihood: maps states `(*batch, S, D)` to `(*batch, S)`.
        predicted: of the state.
        rounds: `(*batch, rounds, S, d)` standard normal draws.
        final: `(*batch, P, D)` standard normal draws.
        transmitting: number of components of which the likelihood speaks, the first; the others are drawn as
            predicted.
    """
    d, (number, entries) = rounds.shape[-1], final.shape[-2:]
    prior = predicted.marginal(d).components
    heard = GaussianMixture(
        predicted.log_weight[..., :transmitting],
        predicted.mean[..., :transmitting, :],
        predicted.tril[..., :transmitting, :, :],
    )

    def at_mean_rates(position: Tensor) -> Tensor:
        state, _ = _with_rates(heard, position, position.new_zeros(*position.shape[:-1], entries - d))
        return log_likelihood(state.flatten(-3, -2)).unflatten(-1, state.shape[-3:-1])

    draws = rounds.movedim(-3, 0).unsqueeze(-3).expand(-1, *heard.mean.shape[:-1], -1, -1)
    proposal, log_evidence = adapt(at_mean_rates, heard.marginal(d).components, draws)
    fitted = Gaussian(
        torch.cat([proposal.fitted.mean, prior.mean[..., transmitting:, :]], -2),
        torch.cat([proposal.fitted.tril, prior.tril[..., transmitting:, :, :]], -3),
    )
    # Of silence the ratio of likelihoods is one.
    log_evidence = pad(log_evidence, (0, predicted.log_weight.shape[-1] - transmitting))
    strata = deal(_shares(predicted.log_weight, log_evidence, proposal.share), number)
    # All components draw every particle, and it is that of its own.
    final = final.unsqueeze(-3).expand(*prior.mean.shape[:-1], -1, -1)
    size = strata.size.to(final.dtype)
    num_prior = (proposal.share * size).round().clamp_min(1)
    as_prior = strata.rank.unsqueeze(-2) < num_prior[..., None]
    position = torch.where(as_prior[..., None], prior.sample(final[..., :d]), fitted.sample(final[..., :d]))
    state, white = _with_rates(predicted, position, final[..., d:])
    log_position, log_fitted = prior.log_prob(position), fitted.log_prob(position)
    log_state = predicted.components.log_prob(state)
    num_fitted = size - num_prior
    log_drawn = torch.logaddexp(
        log_position + num_prior.log()[..., None], log_fitted + num_fitted.log()[..., None]
    )
    log_proposal = log_drawn + log_state - log_position
    parts = (state, white, log_state, log_proposal)
    state, white, log_prior, log_proposal = (of_component(t, strata.component) for t in parts)
    return Drawn(state, strata.component, white, log_prior, log_proposal)


def _with_rates(predicted: GaussianMixture, position: Tensor, white_rate: Tensor) -> tuple[Tensor, Tensor]:
    """States and their standard normal draws, from positions `(*batch, K, S, d)` and draws of the rest."""
    # With L = [[A, 0], [B, C]] the rates given the position are N(m_v + B A^-1 (p - m_p), C C^T).
    d = position.shape[-1]
    white = torch.cat([predicted.marginal(d).components.whiten(position), white_rate], -1)
    return torch.cat([position, predicted.components.sample(white)[..., d:]], -1), white


def _shares(log_weight: Tensor, log_evidence: Tensor, share: float) -> Tensor:
    """Share of the particles of each component: its posterior weight, with an even defensive share."""
    present = log_weight.isfinite()
    posterior = (1 - share) * normalise(log_weight + log_evidence)[0].exp() + share / present.sum(
        -1, keepdim=True
    )
    shares = torch.where(present, posterior, 0.0)
    return shares / shares.sum(-1, keepdim=True)
