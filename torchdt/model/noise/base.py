"""Noise of the sensors: the belief about it, and what a model of it must offer."""

from typing import NamedTuple, Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.weights import weighted_mean
from torchdt.model.measurement import Measurement
from torchdt.model.region import Region


class Noise(NamedTuple):
    """Belief about the noise variance of each tone.

    Attributes:
        variance: `(*batch, I, E)` support points.
        log_weight: `(*batch, I, E)` normalised log-weights.
    """

    variance: Tensor
    log_weight: Tensor

    @property
    def mean(self) -> Tensor:
        """E[eta] of each tone, `(*batch, I)`."""
        return weighted_mean(self.variance, self.log_weight)

    def above(self, least: Tensor) -> "Noise":
        """The same belief with no support point below `(*batch, I)` values."""
        return self._replace(variance=torch.maximum(self.variance, least[..., None]))


@runtime_checkable
class NoiseModel(Protocol):
    """How noise begins, changes, and adds to the covariance of the data."""

    def initial(self, maximum: Tensor, num_points: int) -> Noise:
        """Belief of the first step.

        Args:
            maximum: `(*batch, I)` largest variance before it.
            num_points: E.
        """
        ...

    def predict(self, noise: Noise) -> Noise:
        """Belief one step later."""
        ...

    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """Covariance of the data `(*batch, I, M, M)`, with ones for sensors that are missing.

        Args:
            signal: `(*batch, I, M, M)` complex covariance of what objects send.
            variance: eta, `(*batch, I)`.
            present: `(*batch, I, M)`, 1 for sensors that are there.
        """
        ...

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """Weight the support points by the data, given the covariance of the signal."""
        ...

    def on(self, region: Region) -> Self:
        """The model with numbers in the type and on the device of a region."""
        ...

    def select(self, sequences: slice) -> Self:
        """The model of some sequences of a batch."""
        ...
