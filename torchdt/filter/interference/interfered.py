"""Noise of a step together with signals that are no objects."""

from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseCovariance


@dataclass(frozen=True)
class Interfered:
    """What the noise makes of a signal and of interferers, see `NoiseCovariance`.

    Attributes:
        noise: of the sensors.
        columns: `(*batch, I, M, K)` complex, interferers of covariance `sum_k c_k c_k^H`; constants.
    """

    noise: NoiseCovariance
    columns: Tensor

    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """That of signal, interferers and noise."""
        columns = self._beside(signal)
        return self.noise.covariance(signal + columns @ columns.mH, variance, present)

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """Weight the levels by the data, given signal and interferers."""
        columns = self._beside(signal)
        return self.noise.update(prior, measurement, signal + columns @ columns.mH)

    def log_likelihood(self, measurement: Measurement, columns: Tensor, variance: Tensor) -> Tensor:
        """Of signals `A A^H` beside the interferers."""
        own = self._beside(columns).to(columns.dtype)
        own = own.expand(*columns.shape[:-2], *own.shape[-2:])
        return self.noise.log_likelihood(measurement, torch.cat([columns, own], -1), variance)

    def select(self, sequences: slice | list[int]) -> Self:
        """For some sequences of a batch `(B,)`."""
        return replace(self, noise=self.noise.select(sequences), columns=self.columns[sequences])

    def _beside(self, matrices: Tensor) -> Tensor:
        """The columns, with dimensions of size one behind the batch as `(*batch, ..., I, M, N)` has them."""
        columns = self.columns
        for _ in range(matrices.ndim - columns.ndim):
            columns = columns.unsqueeze(-4)
        return columns
