"""Directions towards an object: coordinates of the state, and the unit vectors they stand for.

Axes are east, north and up. All functions are differentiable, with finite gradients everywhere.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor


class Directions(NamedTuple):
    """One way to give a direction.

    Attributes:
        num_coordinates: number d of position coordinates.
        vector: maps positions `(*batch, d)` to unit vectors `(*batch, 3)`.
        inside: maps positions to whether there is such a direction, `(*batch,)` bool; None: there always is.
        positions: maps unit vectors `(*batch, 3)` to all positions that stand for them, up to whole turns,
            `(n, *batch, d)`; NaN where none does.
        turn: what angles may be off by a multiple of, degrees; None: the position is no angle.
        space: 2 where directions are horizontal, else 3.
    """

    num_coordinates: int
    vector: Callable[[Tensor], Tensor]
    inside: Callable[[Tensor], Tensor] | None
    positions: Callable[[Tensor], Tensor]
    turn: float | None
    space: int


def from_direction_cosines(position: Tensor) -> Tensor:
    """Unit vectors `(*batch, 3)` above the horizon from their parts to the east and north, `(*batch, 2)`.

    What lies outside the unit circle counts as the nearest direction on the horizon.
    """
    square = position.square().sum(-1, keepdim=True)
    above = square < 1
    # Both branches of a selection are differentiated: the root must not see zero or less.
    up = torch.where(above, torch.where(above, 1 - square, 1.0).sqrt(), 0.0)
    return torch.cat([position * square.clamp(min=1).rsqrt(), up], -1)


def in_unit_circle(position: Tensor) -> Tensor:
    """Whether positions `(*batch, 2)` are direction cosines of anything, `(*batch,)` bool."""
    return position.square().sum(-1) <= 1


def from_azimuth_elevation(position: Tensor) -> Tensor:
    """Unit vectors `(*batch, 3)` from azimuth, clockwise from north, and elevation, `(*batch, 2)` degrees."""
    azimuth, elevation = torch.deg2rad(position).unbind(-1)
    level = elevation.cos()
    return torch.stack([level * azimuth.sin(), level * azimuth.cos(), elevation.sin()], -1)


def from_bearing(position: Tensor) -> Tensor:
    """Unit vectors `(*batch, 3)` on the horizon from bearings `(*batch, 1)`, degrees clockwise from north."""
    bearing = torch.deg2rad(position[..., 0])
    return torch.stack([bearing.sin(), bearing.cos(), torch.zeros_like(bearing)], -1)


def to_direction_cosines(vector: Tensor) -> Tensor:
    """Inverse of `from_direction_cosines`, `(*batch, 3)` to `(1, *batch, 2)`; NaN below the horizon."""
    return torch.where(vector[..., 2:] >= 0, vector[..., :2], torch.nan)[None]


def to_azimuth_elevation(vector: Tensor) -> Tensor:
    """Inverse of `from_azimuth_elevation`, `(*batch, 3)` to `(2, *batch, 2)`: also over the zenith."""
    east, north, up = vector.unbind(-1)
    azimuth, elevation = torch.rad2deg(torch.atan2(east, north)), torch.rad2deg(up.clamp(-1, 1).asin())
    over = torch.stack([azimuth + 180, 180 - elevation], -1)
    return torch.stack([torch.stack([azimuth, elevation], -1), over])


def to_bearing(vector: Tensor) -> Tensor:
    """Inverse of `from_bearing`, `(*batch, 3)` to `(1, *batch, 1)`."""
    return torch.rad2deg(torch.atan2(vector[..., 0], vector[..., 1]))[None, ..., None]


DIRECTIONS = {
    "direction_cosines": Directions(
        2, from_direction_cosines, in_unit_circle, to_direction_cosines, turn=None, space=3
    ),
    "azimuth_elevation": Directions(
        2, from_azimuth_elevation, None, to_azimuth_elevation, turn=360.0, space=3
    ),
    "bearing": Directions(1, from_bearing, None, to_bearing, turn=360.0, space=2),
}
