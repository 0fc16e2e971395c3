"""The part of an array's covariances that stands still and that no sky explains.

Receivers that share clock, cables and case hear each other: their covariance has entries that do not change
while objects move. What a time-averaged covariance holds of the sky is a sum of plane waves with weights from
zero up, wherever the objects went, and on each sensor these weights add up to its power at most:

    `min over w >= 0, sum w <= 1 of sum over p < q |mean R_pq - sum_c w_c a_p(u_c) conj a_q(u_c)|^2`,
    where `R_pp = 1`,

a non-negative least-squares problem (C. L. Lawson and R. J. Hanson, Solving Least Squares Problems, 1974,
ch. 23). What is left of `mean R` off the diagonal is no sky. Objects need not be known, and those that stand
still are kept. Weights without the bound would explain everything: cells are more than pairs of sensors.
"""

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from torchdt.field.base import Field
from torchdt.model.region import Region

WEIGHT = 100.0
"""Of the bound on the sum, far above the one of an entry, and so kept to rounding."""


def standing_covariance(covariance: Tensor, field: Field, region: Region) -> Tensor:
    """Estimate it.

    Args:
        covariance: `(K, M, M)` complex128, ones on the diagonal.
        field: of one tone and unit norm, in float64, on the CPU.
        region: the sky; one plane wave from the centre of each cell, in float64.

    Returns:
        `(M, M)` complex128 Hermitian, zero on the diagonal.
    """
    size = covariance.shape[-1]
    cells = region.cell_centres()[region.is_birth_cell]
    response = (size**0.5 * field(cells)[:, 0]).numpy()
    first, second = np.triu_indices(size, 1)
    pairs = (response[:, first] * response[:, second].conj()).T
    mean = covariance.mean(0).numpy()[first, second]
    # The last column takes the rest of a sensor's power, its noise.
    columns = np.zeros((2 * len(pairs) + 1, len(cells) + 1))
    columns[:-1, :-1] = np.concatenate([pairs.real, pairs.imag])
    columns[-1] = WEIGHT
    weight, _ = nnls(columns, np.concatenate([mean.real, mean.imag, [WEIGHT]]), maxiter=30 * len(cells))
    standing = torch.zeros(size, size, dtype=covariance.dtype)
    standing[first, second] = torch.from_numpy(mean - pairs @ weight[:-1])
    return standing + standing.mH


def without_standing(covariance: Tensor, standing: Tensor) -> Tensor:
    """Covariances `(K, M, M)` less a standing part, with ones on the diagonal and no negative eigenvalue."""
    level, vector = torch.linalg.eigh(covariance - standing)
    positive = (vector * level.clamp_min(0.0)[:, None]) @ vector.mH
    power = positive.diagonal(dim1=-2, dim2=-1).real.sqrt()
    return positive / (power[:, :, None] * power[:, None])
