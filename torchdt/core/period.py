"""Coordinates that go round, such as an azimuth: x and x + period are the same place.

Functions on positions `(*batch, d)` with a period `(d,)` each, infinite for a coordinate that does not go
round: its values stay exactly as they are. Whole turns are constants to the gradient.
"""

import math

import torch
from torch import Tensor


def wrap(position: Tensor, low: Tensor, period: Tensor) -> Tensor:
    """The same places within one period from `low` `(d,)` on, `[low, low + period)`."""
    wrapped = position - ((position - low) / period).detach().floor() * _finite(period)
    # Rounding may carry what is next to an end across it; both ends are the same place.
    beyond = (wrapped < low) | (wrapped >= low + period)
    return torch.where(period.isfinite() & beyond, low, wrapped)


def shortest(difference: Tensor, period: Tensor) -> Tensor:
    """The shortest way round for differences of positions, at most half a period."""
    return difference - (difference / period).detach().round() * _finite(period)


def nearest(position: Tensor, centre: Tensor, period: Tensor) -> Tensor:
    """Of each place the value that is closest to a centre, broadcastable to the positions."""
    return position - ((position - centre) / period).detach().round() * _finite(period)


def gather(points: Tensor, log_weight: Tensor, low: Tensor, period: Tensor) -> Tensor:
    """The same weighted places without a seam in between, so that their moments are those of the set.

    Every point goes to within half a period of the circular mean `arg E[exp(i 2 pi x / period)]` (Mardia and
    Jupp, Directional Statistics, 2000, ch. 2.2), then all together to where their mean is in
    `[low, low + period)`.

    Args:
        points: `(*batch, P, d)`.
        log_weight: `(*batch, P)` normalised.
        low, period: `(d,)`.
    """
    weight = log_weight.detach().exp().unsqueeze(-1)
    angle = points.detach() * (2 * math.pi / period)
    sine, cosine = (weight * angle.sin()).sum(-2), (weight * angle.cos()).sum(-2)
    centre = torch.atan2(sine, cosine) * _finite(period) / (2 * math.pi)
    together = nearest(points, centre.unsqueeze(-2), period)
    mean = (weight * together.detach()).sum(-2, keepdim=True)
    return together - ((mean - low) / period).floor() * _finite(period)


def _finite(period: Tensor) -> Tensor:
    """Periods to multiply numbers of turns with, which are zero where there is none: 0 infinity is NaN."""
    return torch.where(period.isfinite(), period, 1.0)
