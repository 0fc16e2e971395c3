"""How well declared directions and tracks follow satellites, in degrees on the sphere."""

import math
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from torchdt.metrics.gospa import Gospa, gospa

CLOSE = 2.0
"""Degrees within which a declared object counts as a satellite."""

STRONGEST = 6
"""Satellites whose label switches are counted."""


class SkyScore(NamedTuple):
    """Scores of one run.

    Attributes:
        gospa: mean over the steps, degrees; its parts follow.
        localisation, missed, false: parts of it.
        declared: mean number of declared objects per step.
        close: share of declared object-steps within `CLOSE` degrees of a satellite; NaN without any.
        median_error: to the nearest satellite, degrees; NaN without any declared.
        switches: steps at which the object matched to one of the strongest satellites has another label than
            the one matched before; None for estimates without labels.
    """

    gospa: float
    localisation: float
    missed: float
    false: float
    declared: float
    close: float
    median_error: float
    switches: int | None


def towards(position: Tensor) -> Tensor:
    """Unit vectors `(*batch, 3)` from direction cosines `(*batch, 2)` to the east and north; NaN stays."""
    up = (1 - position.square().sum(-1, keepdim=True)).clamp_min(0.0).sqrt()
    return torch.cat([position, up], -1)


def sky_gospa(position: Tensor, declared: Tensor, truth: Tensor, cutoff: float = 5.0) -> Gospa:
    """GOSPA of order 1 in degrees; the chord stands for the arc, which is longer by 0.03 % at five degrees.

    Args:
        position: `(*batch, N, 2)` direction cosines.
        declared: `(*batch, N)` bool.
        truth: `(*batch, L, 2)`, NaN = absent.
        cutoff: c, degrees.
    """
    degrees = math.degrees(1.0)
    present = ~truth.isnan().any(-1)
    return gospa(degrees * towards(position), declared, degrees * towards(truth), present, cutoff)


def sky_score(
    position: Tensor,
    declared: Tensor,
    label: Tensor | None,
    power: Tensor,
    truth: Tensor,
    cutoff: float = 5.0,
) -> SkyScore:
    """Score one run.

    Args:
        position: `(K, N, 2)` direction cosines, float64.
        declared: `(K, N)` bool.
        label: `(K, N)` int64; None where estimates have none.
        power: `(K, N)`.
        truth: `(K, L, 2)` direction cosines, NaN = absent.
        cutoff: degrees beyond which nothing is matched.
    """
    score = sky_gospa(position, declared, truth, cutoff)
    chord = torch.cdist(towards(position), towards(truth).nan_to_num(nan=torch.inf))
    angle = torch.rad2deg(2 * (chord.nan_to_num(nan=2.0) / 2).clamp(max=1.0).asin())
    nearest = angle.amin(-1)[declared]
    return SkyScore(
        gospa=score.total.mean().item(),
        localisation=score.localisation.mean().item(),
        missed=score.missed.mean().item(),
        false=score.false.mean().item(),
        declared=declared.sum(-1).double().mean().item(),
        close=(nearest <= CLOSE).double().mean().item(),
        median_error=nearest.median().item() if len(nearest) else math.nan,
        switches=None if label is None else _switches(angle, declared, label, power, cutoff),
    )


def _switches(angle: Tensor, declared: Tensor, label: Tensor, power: Tensor, cutoff: float) -> int:
    """Label switches of the satellites that are matched to the highest mean power over all steps."""
    num_steps, _, num_truth = angle.shape
    matched, strength = torch.zeros(num_steps, num_truth, dtype=torch.int64), torch.zeros(num_truth)
    for step in range(num_steps):
        slots = declared[step].nonzero()[:, 0]
        cost = angle[step, slots].clamp(max=cutoff)
        rows, columns = linear_sum_assignment(np.asarray(cost))
        for row, column in zip(rows, columns, strict=True):
            if cost[row, column] < cutoff:
                matched[step, column] = label[step, slots[row]]
                strength[column] += power[step, slots[row]]
    switches = 0
    for column in strength.argsort(descending=True)[:STRONGEST]:
        labels = matched[:, column][matched[:, column] > 0]
        switches += int((labels[1:] != labels[:-1]).sum())
    return switches
