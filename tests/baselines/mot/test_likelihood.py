"""Points as positions with Gaussian errors."""

import math

import pytest
import torch
from oracles.points import make_region
from torch.distributions import Independent, Normal

from torchdt.baselines.mot.likelihood import GaussianPosition
from torchdt.core.errors import InputError
from torchdt.model.region import Region

F64 = torch.float64
SPREAD = [4.0, 9.0]


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_density_is_the_normal_one(dtype):
    rng = torch.Generator().manual_seed(1)
    point = 50 * torch.rand(2, 3, 5, 2, generator=rng, dtype=dtype)
    state = 50 * torch.rand(2, 3, 4, 7, 4, generator=rng, dtype=dtype)
    found = GaussianPosition(make_region(dtype), SPREAD).log_likelihood(point, state)
    position = state[..., :2].unsqueeze(-3)
    normal = Independent(Normal(position, torch.tensor(SPREAD, dtype=dtype)), 1)
    assert found.dtype == dtype
    torch.testing.assert_close(found, normal.log_prob(point[..., None, :, None, :]))


def test_false_points_are_uniform_in_the_region():
    found = GaussianPosition(make_region(), SPREAD).log_clutter(torch.zeros(2, 3, 2, dtype=F64))
    torch.testing.assert_close(found, torch.full((2, 3), -math.log(1000 * 500), dtype=F64))


def test_false_points_are_uniform_in_what_a_field_leaves_of_the_region():
    """Three quarters of its cells; the density over them integrates to one."""
    box = make_region()
    quarter = torch.tensor([500.0, 150.0], dtype=F64)
    region = Region(box.coordinates, F64, inside=lambda state: (state[..., :2] < quarter).any(-1))
    assert region.num_cells == 3 * 50 * 50 / 4
    likelihood = GaussianPosition(region, SPREAD)
    assert likelihood.log_clutter(torch.zeros(1, 2, dtype=F64)).item() == pytest.approx(-math.log(375_000))
    draws = torch.zeros(1, 1, 4, dtype=F64)
    _, log_weight = likelihood.propose(torch.tensor([[100.0, 300.0]], dtype=F64), draws)
    assert log_weight.item() == pytest.approx(-math.log(375_000))


def test_spread_is_half_a_birth_cell_unless_set():
    assert GaussianPosition(make_region()).spread.tolist() == [10.0, 5.0]
    assert GaussianPosition(make_region(), SPREAD).spread.tolist() == SPREAD


@pytest.mark.parametrize("spread", [[4.0], [4.0, 9.0, 1.0]])
def test_spread_needs_one_number_for_each_coordinate(spread):
    with pytest.raises(InputError, match=r"'tracker\.spread': found \[4.*one number for each of 2"):
        GaussianPosition(make_region(), spread)


def test_points_need_the_coordinates_of_the_region():
    likelihood = GaussianPosition(make_region())
    with pytest.raises(InputError, match=r"'points\.position': found 3 coordinates, expected 2"):
        likelihood.log_likelihood(torch.zeros(5, 3, dtype=F64), torch.zeros(1, 7, 4, dtype=F64))


def test_proposal_is_weighted_to_likelihood_times_birth_density():
    """By its moments on 40,000 particles: positions normal about the point, rates uniform; errors below 5.5
    standard errors (false alarm of 4e-8 for each of 16 numbers)."""
    region, num = make_region(), 40_000
    likelihood = GaussianPosition(region, SPREAD)
    point = torch.tensor([[300.0, 200.0], [500.0, 250.0]], dtype=F64)
    draws = torch.randn(2, num, 4, generator=torch.Generator().manual_seed(2), dtype=F64)
    state, log_weight = likelihood.propose(point, draws)
    torch.testing.assert_close(log_weight, torch.full((2, num), -math.log(1000 * 500), dtype=F64))
    low = torch.cat([point, region.rate_low.expand(2, -1)], -1)
    width = torch.cat([torch.tensor(SPREAD, dtype=F64), region.rate_high - region.rate_low])
    unit = (state - low[:, None]) / width  # standard normal twice, uniform on [0, 1] twice
    for power, moments in ((1, [0, 0, 1 / 2, 1 / 2]), (2, [1, 1, 1 / 3, 1 / 3])):
        value = unit**power
        error = (value.mean(-2) - torch.tensor(moments, dtype=F64)).abs()
        assert (error < 5.5 * value.std(-2) / num**0.5).all()


@pytest.mark.parametrize("spread", [[4.0, 9.0], [40.0, 90.0]])
def test_mean_weight_is_the_integral_at_the_border(spread):
    """A point on a corner: a quarter of its density lies inside. Error below 5 standard errors: 6e-7."""
    region, num = make_region(), 40_000
    draws = torch.randn(1, num, 4, generator=torch.Generator().manual_seed(3), dtype=F64)
    state, log_weight = GaussianPosition(region, spread).propose(region.low[None], draws)
    assert torch.equal(log_weight.isfinite(), region.contains(state))
    share = log_weight.exp().mean() * 1000 * 500
    assert abs(share - 0.25) < 5 * (0.25 * 0.75 / num) ** 0.5
