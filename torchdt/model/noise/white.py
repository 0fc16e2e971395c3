"""White noise: of the same unknown variance on all sensors, which wanders from step to step."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchdt.core.weights import normalise
from torchdt.model.gamma_chain import SHAPE, predict_chain, predicted_uniform_prior
from torchdt.model.measurement import Measurement, mask_covariance
from torchdt.model.noise.base import Noise
from torchdt.model.part import Number, Part, number, widen


@dataclass(frozen=True)
class WhiteNoise(Part):
    """Variance uniform up to a limit before the first step, a Gamma chain from then on: f(eta | eta').

    Liang and Meyer, Sec. IV.

    Attributes:
        noise_shape: c_eta, shape of the Gamma transition, at least 1.
    """

    KEY: ClassVar[str] = "model.noise"

    noise_shape: Number = number(1e2, SHAPE)

    def initial(self, maximum: Tensor, num_points: int) -> Noise:
        """Belief of the first step, see `predicted_uniform_prior`."""
        return Noise(*predicted_uniform_prior(maximum, num_points, widen(self.noise_shape, 1)))

    def predict(self, noise: Noise) -> Noise:
        """One Gamma transition, see `predict_chain`."""
        return Noise(*predict_chain(noise.variance, noise.log_weight, widen(self.noise_shape, 1)))

    def covariance(self, signal: Tensor, variance: Tensor, present: Tensor) -> Tensor:
        """`signal + eta I`, see `mask_covariance`."""
        return mask_covariance(signal, variance, present)

    def update(self, prior: Noise, measurement: Measurement, signal: Tensor) -> Noise:
        """Weight the support points by the data, see `update_noise`."""
        return update_noise(prior, measurement, signal)


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
