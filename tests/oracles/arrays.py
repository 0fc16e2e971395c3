"""Random array data and direct formulas for them, with no algebra taken from the library."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def complex_normal(generator: torch.Generator, *shape: int) -> Tensor:
    """Circular complex normal draws of unit variance."""
    return torch.randn(shape, dtype=torch.complex128, generator=generator)


def random_covariance(generator: torch.Generator, *batch: int, sensors: int) -> Tensor:
    """Well-conditioned random covariances."""
    root = complex_normal(generator, *batch, sensors, sensors)
    return root @ root.mH / sensors + 0.3 * torch.eye(sensors, dtype=torch.complex128)


def sample_covariance(snapshots: Tensor) -> Tensor:
    """Mean of z_j z_j^H over the snapshots; (..., J, M) to (..., M, M)."""
    return snapshots.mT @ snapshots.conj() / snapshots.shape[-2]


def changed(array: NDArray, index: tuple, value: complex) -> NDArray:
    """A copy with other values at an index."""
    array = np.copy(array)
    array[index] = value
    return array


def direct_log_likelihood(snapshots: Tensor, covariance: Tensor) -> Tensor:
    """Sum over J of log CN(z_j; 0, C) by determinant and solve; (..., J, M) and (..., M, M)."""
    sensors = snapshots.shape[-1]
    solved = torch.linalg.solve(covariance.unsqueeze(-3), snapshots.unsqueeze(-1)).squeeze(-1)
    misfit = (snapshots.conj() * solved).sum(-1).real.sum(-1)
    log_det = torch.linalg.slogdet(covariance).logabsdet
    return -snapshots.shape[-2] * (sensors * math.log(math.pi) + log_det) - misfit
