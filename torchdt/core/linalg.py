"""Small dense linear algebra that names its failures."""

import torch
from torch import Tensor


class NumericalError(ArithmeticError):
    """A quantity left the range in which the algorithm makes sense."""


BREAKDOWN = (NumericalError, torch.linalg.LinAlgError)
"""What is raised where numbers break down, here and in PyTorch."""


def cholesky(matrix: Tensor, name: str) -> Tensor:
    """Lower Cholesky factor of a Hermitian matrix, `(*batch, M, M)`.

    Raises:
        NumericalError: naming the matrix and its first bad batch index.
    """
    lower, info = torch.linalg.cholesky_ex(matrix)
    if bool((info != 0).any()):
        where = tuple(int(i) for i in (info != 0).nonzero()[0])
        raise NumericalError(f"{name}: not positive definite at batch index {where}")
    return lower


def check_finite(values: Tensor, name: str) -> Tensor:
    """Return `values`, which may hold minus infinity (a zero weight) but neither NaN nor plus infinity.

    Raises:
        NumericalError: naming the quantity and its first bad batch index.
    """
    # One pass where all is well: a maximum is NaN where any value is.
    if values.numel() and not bool(values.detach().max() < torch.inf):
        where = tuple(int(i) for i in (values.isnan() | values.isposinf()).nonzero()[0])
        raise NumericalError(f"{name}: NaN or infinite at index {where}")
    return values
