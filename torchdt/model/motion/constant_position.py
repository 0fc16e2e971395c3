"""Nearly constant position: a random walk without rates."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchdt.model.motion.base import BaseMotion
from torchdt.model.region import Coordinate, Region


@dataclass(frozen=True)
class ConstantPosition(BaseMotion):
    """`x' = x + T q`: a state of d positions alone, moved by a velocity that is new in every step.

    Per coordinate `q ~ N(0, driving_variance)`, (unit / s)^2; without a variance of its own, the mean square
    of rates that are uniform between the region's limits.
    """

    def num_extra(self, num_coordinates: int) -> int:
        """None."""
        return 0

    def move(self, state: Tensor, driving: Tensor, step_s: float) -> Tensor:
        """New states, `(*batch, d)`."""
        return state + step_s * driving

    def moments(self, mean: Tensor, covariance: Tensor, step_s: float) -> tuple[Tensor, Tensor]:
        """Exact moments after one step: `m` and `C + T^2 Q`."""
        return mean, covariance + step_s**2 * torch.diag_embed(self.driving_variance.unsqueeze(-2))

    def newborn(self, region: Region, position: Tensor, draws: Tensor) -> Tensor:
        """Positions as they are."""
        return position

    def complete(self, region: Region, position: Tensor) -> Tensor:
        """Positions as they are."""
        return position

    def column_names(self, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
        """Positions."""
        return super().column_names(coordinates)[: len(coordinates)]

    def default_variance(self, region: Region) -> Tensor:
        """Mean square of the region's rates."""
        low, high = region.rate_low, region.rate_high
        return (low.square() + low * high + high.square()) / 3
