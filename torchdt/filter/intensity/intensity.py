"""An intensity of undetected objects, carried from step to step.

What no potential object stands for yet is a Poisson intensity over cells, rates and levels of power
(Williams, IEEE Trans. AES 51, 2015; Kropfreiter, Williams and Meyer, FUSION 2021):

    lambda_k|k-1 = p_s T lambda_k-1 + mu_B b,        lambda_k = L_k lambda_k|k-1,

with T the motion and L_k the likelihood ratio of one more object, given the objects and the noise that are
known. Evidence that no single step has adds up over many. An entry of the intensity is the odds that there is
an object with this state and that none other is undetected; the evidence of a step, first order in rare
objects, is `(1 + sum lambda_k) / (1 + sum lambda_k|k-1)`.

To a gradient L_k is a constant, as a search is: the intensity is differentiable in births, survival, motion
and the chain of powers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.context import StepContext
from torchdt.filter.intensity.grid import Hypotheses, Transition
from torchdt.filter.intensity.transport import carry
from torchdt.model.part import append_dims
from torchdt.model.region import Region

if TYPE_CHECKING:
    from torchdt.filter.intensity.settings import Intensity

CEILING = 60.0
"""Of what one step can say for an object, nats: enough for any belief, and e^60 is a number."""

MOST = 1e4
"""Largest entry of an intensity: of what is in the way of potential objects while all slots are taken."""


def predict_intensity(
    intensity: Tensor,
    transition: Transition,
    grid: Hypotheses,
    region: Region,
    survival: Tensor,
    birth_log_odds: Tensor,
) -> Tensor:
    """`p_s T lambda + mu_B b`, `(*batch, V, L, C)`.

    Args:
        intensity: after the last step.
        transition: of one step.
        grid: the hypotheses.
        region: of interest.
        survival: p_s, `(*batch,)`.
        birth_log_odds: `(*batch, C)` of a new object in each cell; as likely at one level as at another.
    """
    d, shape = region.num_coordinates, region.grid_shape
    closed = [coordinate.is_closed for coordinate in region.coordinates]
    moved = []
    for v, row in enumerate(intensity.unflatten(-1, shape).unbind(-2 - d)):
        for j, move in enumerate(transition.cells):
            row = carry(row, move.offset[v], move.weight[..., v, :], j - d, closed[j])
        moved.append(row.flatten(-d))
    values = torch.stack(moved, -3)
    values = (transition.nodes.mT @ values.flatten(-2)).unflatten(-1, values.shape[-2:])
    values = transition.levels.mT.unsqueeze(-3) @ values
    share = grid.node_share[:, None, None] / len(grid.level)
    birth = birth_log_odds.exp()[..., None, None, :] * share
    return torch.where(grid.born, append_dims(survival, 3) * values + birth, 0.0)


def update_intensity(
    predicted: Tensor, log_ratio: Tensor, likelihood_power: Tensor, most: float
) -> tuple[Tensor, Tensor]:
    """`lambda_k = L_k lambda_k|k-1`, and the evidence `(*batch,)`.

    Args:
        predicted: `(*batch, V, L, C)`.
        log_ratio: `(*batch, L, C)` log L_k.
        likelihood_power: `(*batch,)`, to which L_k is raised in the intensity, not in the evidence.
        most: largest logarithm of a ratio in the intensity.
    """
    log_ratio = log_ratio.unsqueeze(-3)
    total = (predicted * log_ratio.clamp_max(CEILING).exp()).sum((-3, -2, -1))
    log_evidence = torch.log1p(total) - torch.log1p(predicted.sum((-3, -2, -1)))
    ratio = (append_dims(likelihood_power, 3) * log_ratio).clamp_max(most).exp()
    return (predicted * ratio).clamp_max(MOST), log_evidence


def tone_powers(
    context: StepContext, noise: Tensor, moment: Tensor, settings: Intensity
) -> tuple[Tensor, Tensor]:
    """Powers of the tones' levels, `(*batch, I, G)`, and their share `(L, 1 + G)`.

    A level is the ratio `gamma a^H N^-1 a`, N the covariance of the noise, in the mean of all cells.

    Args:
        context: model and data of the step.
        noise: `(*batch, I)` noise variance.
        moment: `(I, M, M)` mean of `a a^H` over the cells, or one for each sequence.
        settings: of the intensity.
    """
    nothing = torch.zeros_like(moment).expand(*noise.shape, *moment.shape[-2:])
    measurement = context.measurement
    covariance = context.noise.covariance(nothing, noise, measurement.present)
    root = whiten(measurement, covariance).projection[..., : moment.shape[-1]]
    gain = (root.conj() * (moment @ root)).sum((-2, -1)).real
    level, share = settings.tone_levels(settings.level(noise))
    # Of a tone without data any power will do.
    return level / torch.where(gain > 0, gain, 1.0)[..., None], share
