"""Message from the data to the noise variance."""

import torch
from torch import Tensor

from torchdt.model.measurement import Measurement
from torchdt.particles.weights import normalise
from torchdt.state import Noise


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
    eigenvalue, eigenvector = torch.linalg.eigh(masked)
    energy = (eigenvector.mH @ measurement.factor.to(masked.dtype)).abs().square().sum(-1)
    real = prior.variance.dtype
    # Missing sensors span eigenvectors of eigenvalue zero that hold no energy: each adds -J log eta.
    missing = (1 - present).sum(-1)[..., None]
    level = eigenvalue.clamp_min(0.0).to(real)[..., None, :] + prior.variance[..., None]
    J = measurement.num_snapshots[..., None]
    log_det = level.log().sum(-1) - missing * prior.variance.log()
    log_likelihood = -J * log_det - (energy.to(real)[..., None, :] / level).sum(-1)
    log_weight, _ = normalise(prior.log_weight + log_likelihood)
    return prior._replace(log_weight=log_weight)
