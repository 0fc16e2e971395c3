import math

import pytest
import torch

from torchdt.model.birth import UniformBirth
from torchdt.model.region import Coordinate, Region

F64 = torch.float64


def line(number: int) -> Region:
    return Region([Coordinate("x", "m", 0, number, 1, -1, 1, 1.0)], F64)


def test_birth_odds_are_those_of_poisson_births_in_one_cell():
    mean = 1e-2 / 70
    probability = mean / (mean + 1)
    found = UniformBirth(torch.tensor(1e-2, dtype=F64)).log_odds(line(70), torch.zeros(1, dtype=F64))
    assert found.item() == pytest.approx(math.log(probability / (1 - probability)))


def test_probability_of_no_birth_is_the_product_over_the_cells():
    birth = UniformBirth(torch.tensor([0.3, 2.0], dtype=F64))
    mean = birth.birth_mean
    found = birth.log_none(line(50), torch.tensor([[-torch.inf] * 4, [-7.0] * 4]))
    expected = torch.stack([-50 * torch.log(1 + mean[0] / 50), -46 * torch.log(1 + mean[1] / 50)])
    torch.testing.assert_close(found, expected)
    # Many small cells: a Poisson process that brings nothing.
    many = birth.log_none(line(10**6), torch.tensor([-torch.inf]))
    torch.testing.assert_close(many, -mean, rtol=1e-5, atol=0)
