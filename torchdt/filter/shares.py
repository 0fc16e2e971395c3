"""What the energy of a step is explained by: objects, interferers, noise, or nothing.

With `Sigma = sum_c C_c` over all that is believed to be heard, the conditional mean of part c given the data
is `C_c Sigma^-1 z`, and the energy per snapshot splits without rest into

    `tr(S) / J = sum_c Re tr(C_c Sigma^-1 S) / J`.

Noise that is louder in the data than it is believed to be is unexplained.
"""

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import NoiseCovariance

PARTS = ("objects", "interferers", "noise", "unexplained")


@torch.no_grad()
def energy_shares(beliefs: Beliefs, measurement: Measurement, noise_model: NoiseCovariance) -> Tensor:
    """Share of each tone's energy of every part of `PARTS`, `(*batch, I, 4)`; zero where there is no energy.

    Args:
        beliefs: after the step.
        measurement: statistics of the step.
        noise_model: what the noise makes of the covariance of the data, without interferers.

    Raises:
        NumericalError: where a covariance is not positive definite.
    """
    present = measurement.present
    both = present[..., :, None] * present[..., None, :]
    objects = beliefs.signal * both
    found = beliefs.interferers
    others = torch.zeros_like(objects) if found is None else found.covariance * both
    total = noise_model.covariance(objects + others, beliefs.noise.mean, present)
    lower = cholesky(total.to(torch.complex128), "background covariance")
    scatter = (measurement.factor @ measurement.factor.mH).to(lower.dtype)
    explained = torch.cholesky_solve(scatter, lower)

    def part(covariance: Tensor) -> Tensor:
        return (covariance.to(lower.dtype) * explained.mT).sum((-2, -1)).real / measurement.num_snapshots

    sent, free = part(objects).clamp_min(0), part(others).clamp_min(0)
    noise = part(total * both) - part(objects) - part(others)
    expected = (total - objects - others).diagonal(dim1=-2, dim2=-1).real.mul(present).sum(-1)
    quiet = torch.minimum(noise, expected).clamp_min(0)
    parts = torch.stack([sent, free, quiet, (noise - expected).clamp_min(0)], -1)
    energy = parts.sum(-1, keepdim=True)
    heard = (energy > 0) & (measurement.num_snapshots > 0)[..., None]
    shares = parts / torch.where(heard, energy, 1.0)
    return torch.where(heard, shares, 0.0).to(beliefs.power.dtype)
