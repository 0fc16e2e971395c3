"""How far apart two positions are, for metrics and for the truth that they compare with."""

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from torchdt.core.period import shortest


class Distance(Protocol):
    """Any distance of positions."""

    def __call__(self, position: Tensor, other: Tensor) -> Tensor:
        """Distances `(*batch,)` of positions `(*batch, d)` that broadcast against each other; NaN stays."""
        ...


@dataclass(frozen=True)
class Euclidean:
    """`sqrt(sum_i ((x_i - y_i) / s_i)^2)`, the shortest way round where a coordinate has a period.

    Attributes:
        scale: s, what counts as one, for each coordinate, in its unit; None is one unit of each.
        period: of each coordinate, in its unit; None, for one or all, where it does not go round.
    """

    scale: tuple[float, ...] | None = None
    period: tuple[float | None, ...] | None = None

    def __call__(self, position: Tensor, other: Tensor) -> Tensor:
        """See `Distance`."""
        difference = position - other
        if self.period is not None:
            turn = [math.inf if period is None else period for period in self.period]
            difference = shortest(difference, difference.new_tensor(turn))
        if self.scale is not None:
            difference = difference / difference.new_tensor(self.scale)
        return torch.linalg.vector_norm(difference, dim=-1)


@dataclass(frozen=True)
class GreatCircle:
    """Angle between two directions, degrees: along the great circle through both.

    A position is an azimuth, or an azimuth and an elevation, in degrees; any azimuth of the zenith is the
    same direction. The angle is `2 atan2(|u - v|, |u + v|)` of the unit vectors, which is accurate at all
    angles (Kahan, "How futile are mindless assessments of roundoff in floating-point computation?", 2006,
    sec. 12).
    """

    def __call__(self, position: Tensor, other: Tensor) -> Tensor:
        """See `Distance`."""
        u, v = _towards(position), _towards(other)
        apart, together = (torch.linalg.vector_norm(w, dim=-1) for w in (u - v, u + v))
        return torch.rad2deg(2 * torch.atan2(apart, together))


def _towards(position: Tensor) -> Tensor:
    """Unit vectors `(*batch, 3)`."""
    azimuth, elevation = (torch.deg2rad(angle) for angle in (position[..., 0], position[..., 1:].sum(-1)))
    level = elevation.cos()
    return torch.stack([level * azimuth.cos(), level * azimuth.sin(), elevation.sin()], -1)


EUCLIDEAN = Euclidean()


def distances(position: Tensor, other: Tensor, distance: Distance) -> Tensor:
    """Of each position to each other one, `(*batch, N, d)` and `(*batch, L, d)` to `(*batch, N, L)`."""
    return distance(position.unsqueeze(-2), other.unsqueeze(-3))
