"""How points arise from objects and from clutter."""

import math
from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.core.period import shortest
from torchdt.model.motion.base import Motion
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.region import Region, per_coordinate


class PointLikelihood(Protocol):
    """Any measurement model, given as its likelihood.

    A point z has d_z coordinates, not necessarily those of a state x (D: positions first). All
    densities over z are of the same measure. Values at points or states that mean nothing are not used, but
    none may be NaN.
    """

    def log_likelihood(self, point: Tensor, state: Tensor) -> Tensor:
        """Log f(z | x) of the point of a detected object.

        Args:
            point: `(*batch, M, d_z)`.
            state: `(*batch, N, P, D)`.

        Returns:
            `(*batch, N, M, P)`.
        """
        ...

    def log_clutter(self, point: Tensor) -> Tensor:
        """Log f_c(z) of a false point, `(*batch, M, d_z)` to `(*batch, M)`."""
        ...

    def propose(self, point: Tensor, draws: Tensor) -> tuple[Tensor, Tensor]:
        """Draw states of new objects around their points from a proposal q.

        Args:
            point: `(*batch, M, d_z)`.
            draws: `(*batch, M, P, D)` standard normal.

        Returns:
            States x `(*batch, M, P, D)` and log-weights log [f(z | x) f_b(x) / q(x)] `(*batch, M, P)`, f_b
            being the density of new objects, zero outside the region. The mean weight estimates int f f_b dx.
        """
        ...


class GaussianPosition:
    """Points are positions of objects with Gaussian errors: `z = position + N(0, diag(spread^2))`.

    Of a coordinate that goes round an error is the shortest way: its spread is far below the period.

    False points and new objects are uniform in the region.

    Args:
        region: region of interest.
        spread: standard deviation for each coordinate, in its unit; None takes half a birth cell.
        motion: of objects; None is constant velocity.

    Raises:
        InputError: where `spread` is not one number for each coordinate.
    """

    def __init__(self, region: Region, spread: Sequence[float] | None = None, motion: Motion | None = None):
        self.region, self.motion = region, (ConstantVelocity() if motion is None else motion).on(region)
        self.spread = per_coordinate(spread, region.cell / 2, "tracker.spread")
        self._turn = region.period / self.spread
        # Of the cells in the region, which need not fill its box.
        self._log_volume = region.cell.log().sum() + math.log(region.num_cells)
        self._log_peak = -self.spread.log().sum() - 0.5 * region.num_coordinates * math.log(2 * math.pi)

    def log_likelihood(self, point: Tensor, state: Tensor) -> Tensor:
        """Log f(z | x), see `PointLikelihood`.

        Raises:
            InputError: where points have not as many coordinates as the region.
        """
        d = self.region.num_coordinates
        require(point.shape[-1] == d, "points.position", f"{point.shape[-1]} coordinates", f"{d} coordinates")
        # One coordinate after another, in place: the tensor of N x M x P is the large one.
        scaled = (state[..., :d] / self.spread).mT.contiguous().unsqueeze(-3)
        centre = (point / self.spread)[..., None, :, :, None]

        def error(i: int) -> Tensor:
            straight = scaled[..., i, :] - centre[..., i, :]
            return shortest(straight, self._turn[i]) if self._turn[i].isfinite() else straight

        total = error(0).square_()
        for i in range(1, d):
            other = error(i)
            total.addcmul_(other, other)
        return total.mul_(-0.5).add_(self._log_peak)

    def log_clutter(self, point: Tensor) -> Tensor:
        """Log f_c(z): uniform in the region."""
        return -self._log_volume.expand(point.shape[:-1])

    def propose(self, point: Tensor, draws: Tensor) -> tuple[Tensor, Tensor]:
        """Positions from N(z, spread^2), where f / q = 1; all else from the motion."""
        region, d = self.region, self.region.num_coordinates
        position = point.unsqueeze(-2) + self.spread * draws[..., :d]
        log_weight = torch.where(region.contains(position), -self._log_volume, -torch.inf)
        return self.motion.newborn(region, position, draws[..., d:]), log_weight
