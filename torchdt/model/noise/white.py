"""White noise: of the same unknown variance on all sensors, which wanders from step to step."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchdt.core.weights import normalise
from torchdt.model.measurement import Measurement, low_rank_log_likelihood, mask_covariance
from torchdt.model.noise.base import BaseNoise, Noise


@dataclass(frozen=True)
class WhiteNoise(BaseNoise):
    """`signal + eta I`, with eta unknown: the noise of Liang and Meyer, Sec. II-A."""

    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """See `mask_covariance`."""
        return mask_covariance(signal, variance, present)

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """One eigendecomposition for all support points, see `update_noise`."""
        return update_noise(prior, measurement, signal)

    def log_likelihood(self, measurement: Measurement, columns: Tensor, variance: Tensor) -> Tensor:
        """Matrices of the size of the few columns, see `low_rank_log_likelihood`."""
        return low_rank_log_likelihood(measurement, columns, variance)


WHITE = WhiteNoise()


def update_noise(prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
    """Weight the noise support points by the data, objects moment-matched.

    With `signal = U diag(lambda) U^H`, one eigendecomposition serves every point eta:
    `-sum_m [ J log(lambda_m + eta) + (U^H S U)_mm / (lambda_m + eta) ]`.

    Args:
        prior: predicted belief, batch `(*batch,)`.
        measurement: statistics of one step.
        signal: `(*batch, I, M, M)` complex, sum over the objects of `r E[gamma] E[a a^H]`.
    """
    present = measurement.present
    masked = (signal * (present[..., :, None] * present[..., None, :])).to(torch.complex128)
    eigenvalue, eigenvector = torch.linalg.eigh(masked.detach())
    eigenvalue = eigenvalue.clamp_min(0.0)
    projected = eigenvector.mH @ measurement.factor.to(masked.dtype)
    coupling = None
    if masked.requires_grad:
        # The derivative of eigenvectors is infinite where eigenvalues coincide, as those of a few objects on
        # many sensors do. In the fixed basis the signal is diagonal, and that is all a derivative needs.
        rotated = eigenvector.mH @ masked @ eigenvector
        diagonal = rotated.diagonal(dim1=-2, dim2=-1)
        coupling = rotated - torch.diag_embed(diagonal)
        eigenvalue = eigenvalue + diagonal.real - diagonal.real.detach()
    energy = projected.abs().square().sum(-1)
    real = prior.variance.dtype
    # Missing sensors span eigenvectors of eigenvalue zero that hold no energy: each adds -J log eta.
    missing = (1 - present).sum(-1)[..., None]
    level = eigenvalue.to(real)[..., None, :] + prior.variance[..., None]
    J = measurement.num_snapshots[..., None]
    log_det = level.log().sum(-1) - missing * prior.variance.log()
    log_likelihood = -J * log_det - (energy.to(real)[..., None, :] / level).sum(-1)
    if coupling is not None:
        # First order of tr((D + O)^-1 S) in O, which is zero: adds nothing to the value, all to the gradient.
        solved = projected.unsqueeze(-3) / level[..., None]
        first_order = (solved.conj() * (coupling.unsqueeze(-3) @ solved)).sum((-2, -1)).real
        log_likelihood = log_likelihood + first_order.to(real)
    log_weight, _ = normalise(prior.log_weight + log_likelihood)
    return prior._replace(log_weight=log_weight)
