"""How objects move: what a motion must offer, and a base class for motions driven by Gaussian noise."""

import abc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.resampling import scale_tril
from torchdt.core.support import POSITIVE
from torchdt.model.motion.driving import Gradient, drive
from torchdt.model.part import Number, Part, number
from torchdt.model.region import Coordinate, Region, per_coordinate


@runtime_checkable
class Motion(Protocol):
    """`x' = f(x, q)` with driving noise q; see `BaseMotion`, from which all but the first two come.

    The first d entries of a state are the position, which fields and regions read.
    """

    def num_extra(self, num_coordinates: int) -> int:
        """Number of entries of a state behind its d positions."""
        ...

    def num_driving(self, num_coordinates: int) -> int:
        """Number of entries of the driving noise."""
        ...

    def predict(
        self, state: Tensor, draws: Tensor, step_s: float, gradient: Gradient
    ) -> tuple[Tensor, Tensor]:
        """Move particles.

        Args:
            state: `(*batch, N, P, D)`.
            draws: `(*batch, N, P, num_driving)` standard normal.
            step_s: time step in seconds.
            gradient: how the particles depend on the numbers of the motion.

        Returns:
            New particles, and the log transition ratio `(*batch, N, P)`: zero, but with the gradient.
        """
        ...

    def moments(self, mean: Tensor, covariance: Tensor, step_s: float) -> tuple[Tensor, Tensor]:
        """Mean `(*batch, N, D)` and covariance `(*batch, N, D, D)` one step later."""
        ...

    def newborn(self, region: Region, position: Tensor, draws: Tensor) -> Tensor:
        """States `(*batch, D)` of new objects at `(*batch, d)`, from `(*batch, num_extra)` normal draws."""
        ...

    def complete(self, region: Region, position: Tensor) -> Tensor:
        """States of positions `(*batch, d)` whose other entries are in the middle of theirs."""
        ...

    def column_names(self, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
        """Names of the entries of a state, for tables."""
        ...

    def on(self, region: Region) -> Self:
        """The motion in a region, with numbers of its type and on its device."""
        ...

    def select(self, sequences: slice | list[int]) -> Self:
        """The motion of some sequences of a batch."""
        ...


@dataclass(frozen=True)
class BaseMotion(Part, abc.ABC):
    """A motion that is driven by white Gaussian noise `q ~ N(0, diag(driving_variance))`.

    A motion of one's own says what its state has beside the position (`num_extra`, `newborn`, `complete`,
    `column_names`) and how it moves (`move`).

    Attributes:
        driving_variance: of the driving noise, one for each coordinate; None takes the region's,
            (unit / s^2)^2. A motion with other driving noise says so by `num_driving` and `variance`.
    """

    KEY: ClassVar[str] = "model.motion"

    driving_variance: Number = number(None, POSITIVE, vector=True)

    def num_extra(self, num_coordinates: int) -> int:
        """As many rates as there are coordinates."""
        return num_coordinates

    def num_driving(self, num_coordinates: int) -> int:
        """One driving noise for each coordinate."""
        return num_coordinates

    def variance(self) -> Tensor:
        """Of the driving noise, `(*batch, num_driving)`."""
        return self.driving_variance

    def default_variance(self, region: Region) -> Tensor:
        """The `driving_variance` of a motion that has none of its own, `(d,)`: the region's."""
        return region.driving_variance

    @abc.abstractmethod
    def move(self, state: Tensor, driving: Tensor, step_s: float) -> Tensor:
        """New states f(x, q).

        Args:
            state: `(*batch, D)`.
            driving: `(*batch, num_driving)` driving noise q.
            step_s: time step T in seconds.
        """

    def predict(
        self, state: Tensor, draws: Tensor, step_s: float, gradient: Gradient
    ) -> tuple[Tensor, Tensor]:
        """Move particles, see `Motion.predict`."""
        driving, log_ratio = drive(draws, self.variance().unsqueeze(-2), gradient)
        return self.move(state, driving, step_s), log_ratio

    def moments(self, mean: Tensor, covariance: Tensor, step_s: float) -> tuple[Tensor, Tensor]:
        """Moments after one step by the unscented transform: exact where `move` is linear.

        Sigma points of state and driving noise together, of equal weight and none at the centre: `+-sqrt(n)`
        standard deviations along each of the n directions (Julier and Uhlmann, Proc. IEEE 92, 2004).
        """
        variance = self.variance().unsqueeze(-2).expand(*mean.shape[:-1], -1)
        num_state, num_noise = mean.shape[-1], variance.shape[-1]
        spread = (num_state + num_noise) ** 0.5
        along = spread * scale_tril(covariance).mT
        offsets = torch.cat([along, along.new_zeros(*along.shape[:-2], num_noise, num_state)], -2)
        noise = spread * variance.sqrt().diag_embed()
        driving = torch.cat([noise.new_zeros(*noise.shape[:-2], num_state, num_noise), noise], -2)
        states = mean[..., None, :] + torch.cat([offsets, -offsets], -2)
        moved = self.move(states, torch.cat([driving, -driving], -2), step_s)
        new_mean = moved.mean(-2)
        centred = moved - new_mean[..., None, :]
        return new_mean, centred.mT @ centred / moved.shape[-2]

    def newborn(self, region: Region, position: Tensor, draws: Tensor) -> Tensor:
        """States of new objects, whose rates are uniform between the region's limits."""
        rate = region.rate_low + (region.rate_high - region.rate_low) * torch.special.ndtr(draws)
        return torch.cat([position, rate], -1)

    def complete(self, region: Region, position: Tensor) -> Tensor:
        """States whose rates are in the middle of the region's limits."""
        middle = (region.rate_low + region.rate_high) / 2
        return torch.cat([position, middle.expand_as(position)], -1)

    def column_names(self, coordinates: Sequence[Coordinate]) -> tuple[str, ...]:
        """Positions, then rates."""
        positions = [f"{c.name}_{c.unit}" for c in coordinates]
        return (*positions, *(f"{c.name}_rate_{c.unit}ps" for c in coordinates))

    def on(self, region: Region) -> Self:
        """The motion in a region, whose driving variance it takes where it has none of its own.

        Raises:
            InputError: where `driving_variance` is not one number for each coordinate.
        """
        variance = self.driving_variance
        if not isinstance(variance, Tensor):
            key = f"{self.KEY}.driving_variance"
            variance = per_coordinate(variance, self.default_variance(region), key)
        return super(BaseMotion, replace(self, driving_variance=variance)).on(region)
