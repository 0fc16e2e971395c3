import math

import pytest
import torch

from torchdt.model.birth import birth_log_odds, log_no_birth

F64 = torch.float64


def test_birth_odds_are_those_of_poisson_births_in_one_cell():
    mean = 1e-2 / 70
    probability = mean / (mean + 1)
    found = birth_log_odds(torch.tensor(1e-2, dtype=F64), 70)
    assert found.item() == pytest.approx(math.log(probability / (1 - probability)))


def test_probability_of_no_birth_is_the_product_over_the_cells():
    mean = torch.tensor([0.3, 2.0], dtype=F64)
    found = log_no_birth(mean, 50, torch.tensor([0, 4]))
    expected = torch.stack([-50 * torch.log(1 + mean[0] / 50), -46 * torch.log(1 + mean[1] / 50)])
    torch.testing.assert_close(found, expected)
    # Many small cells: a Poisson process that brings nothing.
    many = log_no_birth(mean, 10**7, torch.tensor(0))
    torch.testing.assert_close(many, -mean, rtol=1e-6, atol=0)
