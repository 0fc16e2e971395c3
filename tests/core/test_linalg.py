"""Small dense linear algebra names its failures."""

import pytest
import torch

from torchdt.core.linalg import NumericalError, check_finite, cholesky


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_values_that_are_not_finite_are_named(bad):
    values = torch.zeros(2, 3)
    values[1, 2] = bad
    with pytest.raises(NumericalError, match=r"message: NaN or infinite at index \(1, 2\)"):
        check_finite(values, "message")


def test_a_weight_of_zero_has_a_logarithm_of_minus_infinity():
    for values in (torch.tensor([0.0, -torch.inf]), torch.tensor([-torch.inf]), torch.empty(0)):
        assert check_finite(values, "message") is values


def test_an_indefinite_matrix_is_named():
    matrix = torch.stack([torch.eye(2), -torch.eye(2)])
    with pytest.raises(NumericalError, match=r"background: not positive definite at batch index \(1,\)"):
        cholesky(matrix, "background")
