"""Nearly constant speed and turn rate in a plane, driven by white acceleration."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.core.support import POSITIVE
from torchdt.model.motion.base import BaseMotion
from torchdt.model.part import Number, append_dims, number
from torchdt.model.region import Coordinate, Region


@dataclass(frozen=True)
class ConstantTurn(BaseMotion):
    """An arc of a circle in two coordinates: two positions, their rates, and the turn rate w in rad / s.

    The closed form of Bar-Shalom, Kirubarajan and Li, Estimation with Applications to Tracking and
    Navigation, Sec. 11.7.1: over a step T, `x' = x + sin(w T) / w u - (1 - cos(w T)) / w v`,
    `y' = y + (1 - cos(w T)) / w u + sin(w T) / w v`, and the rates (u, v) turn by the angle w T, from the
    first coordinate to the second. White noise of `driving_variance` drives the rates as in constant
    velocity, and noise of `turn_variance` the turn rate, `w' = w + T q`.

    Attributes:
        turn_variance: of the driving noise of the turn rate, (rad / s^2)^2.
        turn_spread: standard deviation of the turn rate of a new object, rad / s.

    Raises:
        InputError: in a region of another number of coordinates.
    """

    turn_variance: Number = number(1e-6, POSITIVE)
    turn_spread: Number = number(0.05, POSITIVE)

    def num_extra(self, num_coordinates: int) -> int:
        """Rates and the turn rate."""
        return num_coordinates + 1

    def num_driving(self, num_coordinates: int) -> int:
        """Noise of the rates and of the turn rate."""
        return num_coordinates + 1

    def variance(self) -> Tensor:
        """Of the driving noise, `(*batch, 3)`."""
        turn = self.turn_variance[..., None]
        batch = torch.broadcast_shapes(self.driving_variance.shape[:-1], turn.shape[:-1])
        return torch.cat([self.driving_variance.expand(*batch, -1), turn.expand(*batch, -1)], -1)

    def move(self, state: Tensor, driving: Tensor, step_s: float) -> Tensor:
        """New states, `(*batch, 5)`."""
        position, rate, turn = state.split([2, 2, 1], -1)
        push, twist = driving.split([2, 1], -1)
        # sin(w T) / w and (1 - cos(w T)) / w by sin(z) / z, which is smooth where w is zero.
        angle = step_s * turn
        along = step_s * torch.sinc(angle / torch.pi)
        across = step_s * (angle / 2) * torch.sinc(angle / (2 * torch.pi)).square()
        sideways = torch.stack([-rate[..., 1], rate[..., 0]], -1)
        return torch.cat(
            [
                position + along * rate + across * sideways + 0.5 * step_s**2 * push,
                torch.cos(angle) * rate + torch.sin(angle) * sideways + step_s * push,
                turn + step_s * twist,
            ],
            -1,
        )

    def newborn(self, region: Region, position: Tensor, draws: Tensor) -> Tensor:
        """States of new objects: rates uniform between the region's limits, normal turn rates."""
        turn = append_dims(self.turn_spread, draws.ndim - self.turn_spread.ndim) * draws[..., 2:]
        return torch.cat([super().newborn(region, position, draws[..., :2]), turn], -1)

    def complete(self, region: Region, position: Tensor) -> Tensor:
        """States whose rates are in the middle of the region's limits, going straight."""
        state = super().complete(region, position)
        return torch.cat([state, torch.zeros_like(state[..., :1])], -1)

    def column_names(self, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
        """Positions, rates, turn rate."""
        return (*super().column_names(coordinates), "turn_rate_radps")

    def on(self, region: Region) -> Self:
        """The motion in a plane.

        Raises:
            InputError: where the region has not two coordinates.
        """
        found = f"constant turn in {region.num_coordinates} coordinates"
        require(region.num_coordinates == 2, self.KEY, found, "two coordinates")
        return super().on(region)
