"""What one time step of array data says: the scatter matrix, through a factor, and snapshot counts."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.core.trees import tree_map

ROUNDING = 4.0
"""Relative error of a covariance that is a sum of responses, in units of the rounding error of one number."""


class Measurement(NamedTuple):
    """Sufficient statistics of the snapshots of one or more time steps.

    The J snapshots of a tone enter the likelihood only through their scatter matrix
    `S = sum_j z_j z_j^H = B B^H` and J. The factor B is kept because it is smaller than S for few
    snapshots and keeps twice the digits.

    Attributes:
        factor: `(*batch, I, M, R)` complex B; zero in the rows of missing sensors.
        num_snapshots: `(*batch, I)` real J, the number of snapshots; 0 where all are missing.
        present: `(*batch, I, M)` real, 1 for a sensor with data and 0 for a missing one.
    """

    factor: Tensor
    num_snapshots: Tensor
    present: Tensor

    @property
    def energy(self) -> Tensor:
        """Received energy per snapshot `tr(S) / J`, `(*batch, I)`; 0 without snapshots."""
        return self.factor.abs().square().sum((-2, -1)) / self.num_snapshots.clamp_min(1.0)

    def at(self, step: int) -> "Measurement":
        """Select one step of a sequence stored as `(*batch, K, I, ...)`."""
        return Measurement(
            self.factor[..., step, :, :, :], self.num_snapshots[..., step, :], self.present[..., step, :, :]
        )

    def unsqueeze(self) -> "Measurement":
        """Add a batch dimension behind `*batch`, to broadcast over objects."""
        return Measurement(
            self.factor.unsqueeze(-4), self.num_snapshots.unsqueeze(-2), self.present.unsqueeze(-3)
        )

    def silent(self) -> "Measurement":
        """Statistics of the same shape without any data."""
        return tree_map(torch.zeros_like, self)

    def tempered(self, power: Tensor | float) -> "Measurement":
        """Raise the likelihood to a power: an effective number of `power * J` snapshots.

        Args:
            power: real, broadcastable to `(*batch, I)`.
        """
        power = torch.as_tensor(power, dtype=self.num_snapshots.dtype, device=self.num_snapshots.device)
        return self._replace(
            factor=self.factor * power.sqrt()[..., None, None], num_snapshots=self.num_snapshots * power
        )

    def recounted(self, num_snapshots: Tensor) -> "Measurement":
        """Sample covariances `S / J` as before, each of another number J; steps without data stay without.

        Args:
            num_snapshots: J > 0, real, broadcastable to `(*batch, I)`.
        """
        return self.tempered(num_snapshots / torch.where(self.num_snapshots > 0, self.num_snapshots, 1.0))


def from_snapshots(snapshots: Tensor) -> Measurement:
    """Statistics of raw snapshots.

    NaN means missing. A snapshot that lacks more than half of the tone's sensors is left out as a
    whole; a sensor that then still lacks in any remaining snapshot is left out for that tone and step.

    Args:
        snapshots: `(*batch, I, J, M)` complex.

    Returns:
        Measurement with R = min(J, M).
    """
    observed = ~snapshots.isnan()
    usable = observed.sum(-1, keepdim=True) * 2 > observed.any(-2, keepdim=True).sum(-1, keepdim=True)
    present = (observed | ~usable).all(-2) & usable.any(-2)
    kept = torch.where(usable & present[..., None, :], snapshots, torch.zeros_like(snapshots))
    factor = kept.mT
    if factor.shape[-1] > factor.shape[-2]:
        factor = _square_root(factor @ factor.mH)
    real = snapshots.real.dtype
    return Measurement(factor, usable[..., 0].sum(-1).to(real), present.to(real))


def from_covariance(covariance: Tensor, num_snapshots: float) -> Measurement:
    """Statistics of sample covariances `S / J`; a sensor whose variance is NaN is missing.

    Args:
        covariance: `(*batch, I, M, M)` complex Hermitian.
        num_snapshots: J, the number of snapshots (or of effective ones) behind each covariance.
    """
    real = covariance.real.dtype
    present = ~covariance.diagonal(dim1=-2, dim2=-1).isnan()
    kept = present[..., :, None] & present[..., None, :] & ~covariance.isnan()
    scatter = num_snapshots * torch.where(kept, covariance, torch.zeros_like(covariance))
    count = num_snapshots * present.any(-1).to(real)
    return Measurement(_square_root(scatter), count, present.to(real))


def _square_root(scatter: Tensor) -> Tensor:
    eigenvalue, eigenvector = torch.linalg.eigh(scatter)
    return eigenvector * eigenvalue.clamp_min(0.0).sqrt()[..., None, :]


def gaussian_log_likelihood(measurement: Measurement, covariance: Tensor) -> Tensor:
    """`log f(z | C) = -J (M log pi + log|C|) - tr(C^-1 S)` per tone (Liang and Meyer, Sec. II-A).

    Args:
        measurement: statistics, batch `(*batch, I)`.
        covariance: `(*batch, I, M, M)` complex, positive definite, with the noise variance on the
            diagonal of missing sensors (see `mask_covariance`).

    Returns:
        `(*batch, I)` real; the constant counts only sensors that are present.

    Raises:
        NumericalError: where C is not positive definite.
    """
    # Signals far above the noise make C ill-conditioned: in double, as all factorisations of it are.
    factor = measurement.factor
    lower = cholesky(covariance.to(torch.complex128), "measurement covariance")
    present = measurement.present
    log_diagonal = lower.diagonal(dim1=-2, dim2=-1).real.log()
    log_det = 2 * (present * log_diagonal).sum(-1)
    whitened = torch.linalg.solve_triangular(lower, factor.to(lower.dtype), upper=False)
    misfit = whitened.abs().square().sum((-2, -1))
    value = -measurement.num_snapshots * (present.sum(-1) * math.log(math.pi) + log_det) - misfit
    return value.to(factor.real.dtype)


def low_rank_log_likelihood(measurement: Measurement, columns: Tensor, noise: Tensor) -> Tensor:
    """`gaussian_log_likelihood` for `C = A A^H + eta I`, with matrices of the size of the few columns of A.

    By the determinant lemma and the Woodbury identity, with `L L^H = A^H A + eta I`: `log|C| =
    (M - N) log eta + log|L L^H|` and `tr(C^-1 S) = (|B|^2 - |L^-1 A^H B|^2) / eta`. At high signal-to-noise
    ratio that is a small difference of large numbers: give it double precision.

    Args:
        measurement: statistics, batch `(*batch, I)`.
        columns: A, `(*batch, I, M, N)` complex.
        noise: eta > 0, `(*batch, I)` real.

    Returns:
        `(*batch, I)` real; the constant counts only sensors that are present.

    Raises:
        NumericalError: where `A^H A + eta I` is not positive definite.
    """
    masked = columns * measurement.present[..., None]
    eye = torch.eye(columns.shape[-1], dtype=columns.dtype, device=columns.device)
    lower = cholesky(masked.mH @ masked + noise[..., None, None] * eye, "measurement covariance")
    num_sensors = measurement.present.sum(-1)
    log_diagonal = lower.diagonal(dim1=-2, dim2=-1).real.log()
    log_det = (num_sensors - columns.shape[-1]) * noise.log() + 2 * log_diagonal.sum(-1)
    projected = torch.linalg.solve_triangular(lower, masked.mH @ measurement.factor, upper=False)
    energy = measurement.factor.abs().square().sum((-2, -1)) - projected.abs().square().sum((-2, -1))
    return -measurement.num_snapshots * (num_sensors * math.log(math.pi) + log_det) - energy / noise


def mask_covariance(signal: Tensor, noise: Tensor, present: Tensor) -> Tensor:
    """`C = signal + eta I` with the rows and columns of missing sensors removed from the signal part.

    A sum of responses in floating point is known to `eps tr(signal)`, and what is subtracted by rounding must
    not make C indefinite: noise below a few times that counts as so much.

    Args:
        signal: `(*batch, I, M, M)` complex.
        noise: `(*batch, I)` real variance eta.
        present: `(*batch, I, M)` real mask.
    """
    masked = signal * (present[..., :, None] * present[..., None, :])
    eye = torch.eye(signal.shape[-1], dtype=signal.dtype, device=signal.device)
    trace = masked.detach().diagonal(dim1=-2, dim2=-1).real.sum(-1)
    level = torch.maximum(noise, ROUNDING * torch.finfo(noise.dtype).eps * trace)
    return masked + level[..., None, None] * eye
