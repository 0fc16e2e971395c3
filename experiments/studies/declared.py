"""When trackers declare a source, and how often one that is not there."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from scipy.stats import binomtest, chi2
from torch import Tensor

from torchdt.filter.history import TrackHistory
from torchdt.model.distance import Distance, distances

CONFIDENCE = 0.95


class Estimate(NamedTuple):
    """A number with the ends of its 95 % interval."""

    value: float
    low: float
    high: float


def first_declared(history: TrackHistory, track: Tensor, cutoff: float, distance: Distance) -> Tensor:
    """Steps until an object is declared near a source.

    Args:
        history: batch `(B,)`, on the CPU.
        track: `(B, K, d)` of the source.
        cutoff: distance below which an object is the source.
        distance: of an estimate and a true position.

    Returns:
        `(B,)` float64: 1 where the first step declares it, infinity where none does.
    """
    apart = distances(history.position.double(), track[..., None, :], distance)[..., 0]
    return first_true((history.declared & (apart < cutoff)).any(-1))


def first_true(happens: Tensor) -> Tensor:
    """Number of the first step in which something happens, `(*batch, K)` to `(*batch,)`; infinity if none."""
    first = happens.double().argmax(-1).double() + 1
    return torch.where(happens.any(-1), first, torch.inf)


def num_tracks(history: TrackHistory) -> int:
    """Tracks that were ever declared in all sequences: labels, each of which is one track."""
    return sum(
        len(label[declared].unique()) for label, declared in zip(history.label, history.declared, strict=True)
    )


def num_begun(declared: Tensor) -> int:
    """Stretches of steps `(*batch, K)` in which something is declared."""
    before = torch.cat([torch.zeros_like(declared[..., :1]), declared[..., :-1]], -1)
    return int((declared & ~before).sum())


def share(count: int, number: int) -> Estimate:
    """A probability from so many out of a number (Clopper and Pearson, Biometrika 1934)."""
    limits = binomtest(count, number).proportion_ci(CONFIDENCE, method="exact")
    return Estimate(count / number, float(limits.low), float(limits.high))


def rate(count: int, hours: float) -> Estimate:
    """Events per hour of a Poisson process (Garwood, Biometrika 1936)."""
    tail = (1 - CONFIDENCE) / 2
    low = chi2.ppf(tail, 2 * count) / 2 if count else 0.0
    return Estimate(count / hours, low / hours, chi2.ppf(1 - tail, 2 * count + 2) / 2 / hours)


def level_of_half(levels: Sequence[float], shares: Sequence[float]) -> float:
    """Level from which on one half and more is declared, linear between two levels; NaN where none is that.

    Args:
        levels: rising.
        shares: of each.
    """
    below = np.flatnonzero(np.asarray(shares) < 0.5)
    if not below.size or below[-1] + 1 == len(levels):
        return math.nan
    last = below[-1]
    part = (0.5 - shares[last]) / (shares[last + 1] - shares[last])
    return levels[last] + part * (levels[last + 1] - levels[last])
