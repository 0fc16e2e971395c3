"""The density of a sample covariance in the number of snapshots behind it.

The likelihood of J snapshots says how well a covariance C fits them, whatever J. To say how many snapshots a
sample covariance R is worth, its own density is needed (N. R. Goodman, Ann. Math. Statist. 34, 1963): with
`S = J R` and m sensors

    log f(R | C, J) = -J log|C| - tr(C^-1 S) + J m log J + (J - m) log|R| - log Gamma_m(J),
    Gamma_m(J) = pi^(m (m - 1) / 2) prod_(i < m) Gamma(J - i),

for any real `J > m - 1`.
"""

import math

import torch
from torch import Tensor

from torchdt.core.linalg import NumericalError, cholesky
from torchdt.model.measurement import Measurement


def log_normaliser(measurement: Measurement, count: Tensor) -> Tensor:
    """What the likelihood of J snapshots lacks to be the density of their sample covariance.

    It is that of the density in `|R|^(J_0 - m) dR`, with the number J_0 that comes with the data: it changes
    with the unit of the data as the likelihood of J_0 snapshots does, and J_0 may be any number.

    Args:
        measurement: of J_0 snapshots and any scatter matrix that is positive definite, batch `(*batch, I)`.
        count: J, real, broadcastable to `(*batch, I)`.

    Returns:
        `(*batch, I)` float64: `log f(R | C, J) - gaussian_log_likelihood` of `measurement.recounted(count)`,
        less `(J_0 - m) log|R|`; zero without data.

    Raises:
        NumericalError: where J is not above m - 1, or a sample covariance is not positive definite: of fewer
            snapshots than sensors, it has no such density.
    """
    nominal = measurement.num_snapshots.double()
    observed, present = nominal > 0, measurement.present.double()
    size = present.sum(-1)
    count = torch.where(observed, count.double(), size)
    if not (count > size - 1).all():
        raise NumericalError(
            f"effective count: {count.detach().min().item():.3g} snapshots for the sample covariance of "
            f"{int(size.max())} sensors, which has a density from above {int(size.max()) - 1} on"
        )
    factor = measurement.factor.to(torch.complex128)
    # Missing sensors, which all are in a step without data, add ones to the diagonal.
    scatter = factor @ factor.mH + torch.diag_embed(1.0 - present).to(factor)
    lower = cholesky(scatter, "sample covariance")
    unit = torch.where(observed, nominal, 1.0)
    log_det = 2 * lower.diagonal(dim1=-2, dim2=-1).real.log().sum(-1) - size * unit.log()
    term = size * count * (math.pi * count).log() + (count - nominal) * log_det - _log_gamma(count, present)
    return torch.where(observed, term, 0.0)


def _log_gamma(count: Tensor, present: Tensor) -> Tensor:
    """`log Gamma_m(J)` for the m sensors that are present."""
    size = present.sum(-1)
    index = torch.arange(present.shape[-1], dtype=count.dtype, device=count.device)
    inside = index < size[..., None]
    terms = torch.where(inside, torch.lgamma(torch.where(inside, count[..., None] - index, 1.0)), 0.0)
    return size * (size - 1) / 2 * math.log(math.pi) + terms.sum(-1)
