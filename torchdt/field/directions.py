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
        inside: maps positions to whether there is such a direction, `(*batch,)` bool.
    """

    num_coordinates: int
    vector: Callable[[Tensor], Tensor]
    inside: Callable[[Tensor], Tensor]


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


def _everywhere(position: Tensor) -> Tensor:
    return torch.ones_like(position[..., 0], dtype=torch.bool)


DIRECTIONS = {
    "direction_cosines": Directions(2, from_direction_cosines, in_unit_circle),
    "azimuth_elevation": Directions(2, from_azimuth_elevation, _everywhere),
    "bearing": Directions(1, from_bearing, _everywhere),
}
