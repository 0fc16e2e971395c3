"""The search for new objects: matching pursuit on what is left unexplained, refined between the cells.

Cells are picked one after another where one more object raises the likelihood most, given the known
objects, the earlier picks and the noise. Each pick is refined off the grid before the next, since at
30 dB half a cell beside the peak is enough energy left over for a ghost. Picks stop early when even at
the peak of the likelihood the posterior existence would stay below the pruning threshold; while the noise
level is unknown they are judged together.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.importance import Box
from torchdt.core.weights import weighted_mean
from torchdt.field.base import BaseField, Field
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.bp.rank_one import Whitener, peak_log_likelihood_ratio, statistics, whiten
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.base import Proposal
from torchdt.filter.proposal.cells import Unexplained, cell_statistics, received_power
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.proposal.moved import respond
from torchdt.filter.proposal.strongest import strongest_cell
from torchdt.model.existence import drop_outside
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.noise.base import Noise, NoiseCovariance
from torchdt.model.noise.white import WHITE
from torchdt.model.region import Region

ADAPTED = Adapted()
UNSETTLED = 0.25
"""Variance of the logarithm of a noise variance from which on the noise level counts as unknown: a factor of
1.6 either way, while after a step of data on I x M x J values it is known to some per cent."""


Favour = Callable[[Tensor], Tensor]
"""From positions `(*batch, ..., d)` to the log-odds of a birth there beside those where they are largest."""


def no_favour(position: Tensor) -> Tensor:
    """New objects are as likely in one place as in another."""
    return torch.zeros_like(position[..., 0])


class Picks(NamedTuple):
    """Refined picks, in order of picking.

    Attributes:
        position: `(*batch, Q, d)`.
        power: `(*batch, Q, I)` the best power of each tone; zero where inactive.
        scale: `(*batch, Q, I)` where the likelihood of the power lies: the best one, or that which drowns in
            the background; infinite for a tone without data.
        moment: `(*batch, Q, I, M, M)` complex `a a^H`, diffuse part included.
        diffuse: `(*batch, Q, I, M, M)` complex covariance per unit power, None where the model is exact.
        active: `(*batch, Q)` bool.
    """

    position: Tensor
    power: Tensor
    scale: Tensor
    moment: Tensor
    diffuse: Tensor | None
    active: Tensor


def search(
    field: BaseField,
    region: Region,
    dictionary: Dictionary,
    measurement: Measurement,
    signal: Tensor,
    noise: Noise,
    free: Tensor,
    threshold: Tensor,
    rounds: Tensor,
    *,
    proposal: Proposal = ADAPTED,
    favour: Favour = no_favour,
    noise_model: NoiseCovariance = WHITE,
) -> tuple[Picks | None, Noise, Unexplained]:
    """Pick cells and refine them.

    Args:
        measurement: statistics of the step, batch `(*batch,)`.
        signal: `(*batch, I, M, M)` covariance of the known objects.
        noise: predicted noise belief.
        free: `(*batch,)` int64, how many new objects there is room for.
        threshold: `(*batch,)`, smallest log-likelihood ratio at its peak that is worth a new object.
        rounds: `(*batch, Q, rounds, S, d)` standard normal draws; Q is the largest number of picks.
        proposal: refines picks between the points of the grid, or not.
        favour: of places, where new objects are not as likely everywhere; the threshold is that of the best.
        noise_model: what the noise makes of the covariance of the data.

    Returns:
        The picks, as many as any batch element needs (None if no element needs any); the noise belief with
        the known objects and the picks explained; what the known objects leave.
    """
    known, belief = signal, noise_model.update(noise, measurement, signal)
    whitener = whiten(measurement, noise_model.covariance(signal, belief.mean, measurement.present))
    residual = Unexplained(cell_statistics(dictionary, whitener), belief.mean, received_power(signal))
    # While the noise level is unknown, sources that are many and equal each pass for noise: look further.
    unsettled = _log_variance(noise).amax(-1) > UNSETTLED
    alive = torch.ones_like(free, dtype=torch.bool)
    points = dictionary.points.expand(*free.shape, -1, -1)
    favour_of_cells, favoured = favour(points), torch.zeros_like(threshold)
    picked: list[tuple[Tensor, ...]] = []
    scattered: list[Tensor] = []
    gains = [_log_likelihood(measurement, signal, belief, noise_model)]
    for pick in range(rounds.shape[-4]):
        if pick:
            whitener = whiten(measurement, noise_model.covariance(signal, belief.mean, measurement.present))
        cells = None if pick else residual.cells
        score, cell = strongest_cell(dictionary, whitener, alive, favour_of_cells, cells)
        alive = alive & ((score > threshold) | unsettled) & (pick < free) & ~score.isneginf()
        if not bool(alive.any()):
            break
        centre, draws = dictionary.points[cell], rounds[..., pick, :, :, :].movedim(-3, 0)
        position, own = _refine(field, region, whitener, centre, draws, proposal, favour)
        favoured = favoured + torch.where(alive, own, 0.0)
        response = respond(field, position[..., None, :])
        s, q = statistics(whitener, response)
        _, power = peak_log_likelihood_ratio(whitener.num_snapshots, s[..., 0], q[..., 0])
        scale = torch.maximum(power, 1 / s[..., 0])
        power = torch.where(alive[..., None], power, 0.0)
        moment = response.mT @ response.conj()
        scatter = field.diffuse(position)
        if scatter is not None:
            scattered.append(scatter)
            moment = moment + scatter
        signal = signal + power[..., None, None] * moment
        belief = noise_model.update(noise, measurement, signal)
        gains.append(_log_likelihood(measurement, signal, belief, noise_model) + favoured)
        picked.append((position, power, scale, moment, alive))
    if not picked:
        return None, belief, residual
    dim = free.ndim
    position, power, scale, moment, alive = (torch.stack(parts, dim) for parts in zip(*picked, strict=True))
    # Together the picks up to the last one kept are worth the threshold each.
    gain = torch.stack(gains[1:], dim) - gains[0][..., None]
    rank = torch.arange(1, len(picked) + 1, dtype=gain.dtype, device=gain.device)
    worthy = (alive & (gain > rank * threshold[..., None])).flip(-1).cummax(-1).values.flip(-1)
    active = torch.where(unsettled[..., None], worthy, alive)
    power = torch.where(active[..., None], power, 0.0)
    if bool((alive & ~active).any()):
        belief = noise_model.update(noise, measurement, known + signal_covariance(power, moment))
    diffuse = torch.stack(scattered, dim) if scattered else None
    picks = Picks(position, power, scale, moment, diffuse, active)
    return (picks if bool(active.any()) else None), belief, residual


def _log_variance(noise: Noise) -> Tensor:
    """Variance of log eta, `(*batch, I)`."""
    log_value = noise.variance.log()
    mean = weighted_mean(log_value, noise.log_weight)
    return weighted_mean((log_value - mean[..., None]).square(), noise.log_weight)


def _log_likelihood(
    measurement: Measurement, signal: Tensor, noise: Noise, noise_model: NoiseCovariance
) -> Tensor:
    covariance = noise_model.covariance(signal, noise.mean, measurement.present)
    return gaussian_log_likelihood(measurement, covariance).sum(-1)


def _refine(
    field: Field,
    region: Region,
    whitener: Whitener,
    centre: Tensor,
    rounds: Tensor,
    proposal: Proposal,
    favour: Favour,
) -> tuple[Tensor, Tensor]:
    """Position of a pick near the cell picked, `(*batch, d)`, and how births favour it, `(*batch,)`."""

    def peak(position: Tensor) -> Tensor:
        s, q = statistics(whitener, respond(field, position))
        gain = peak_log_likelihood_ratio(whitener.num_snapshots[..., None], s, q)[0].sum(-2)
        return drop_outside(position, gain + favour(position), region)

    low, high = torch.maximum(centre - region.cell, region.lower_end), centre + region.cell
    around = Box(low, torch.minimum(high, region.upper_end))
    position = proposal.refine(peak, centre, around, rounds)
    refined = favour(position)
    # Between places where objects are born there may be one where none is.
    born = ~refined.isneginf()
    return torch.where(born[..., None], position, centre), torch.where(born, refined, favour(centre))
