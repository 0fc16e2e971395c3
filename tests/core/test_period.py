import math

import pytest
import torch

from torchdt.core import period as periods

F64 = torch.float64
LOW = torch.tensor([-180.0, 5.0], dtype=F64)
PERIOD = torch.tensor([360.0, torch.inf], dtype=F64)


def first(*values: float) -> torch.Tensor:
    """Positions whose second coordinate does not go round."""
    return torch.tensor([[value, -7e3] for value in values], dtype=F64)


def test_wrapped_values_are_the_same_places_within_one_period():
    wrapped = periods.wrap(first(-180.0, 180.0, 179.5, 190.0, -900.5, 0.0), LOW, PERIOD)
    assert wrapped[:, 0].tolist() == [-180.0, -180.0, 179.5, -170.0, 179.5, 0.0]
    assert (wrapped[:, 1] == -7e3).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_rounding_never_carries_a_value_out_of_the_period(dtype):
    """An ulp beside any whole number of turns, on both sides."""
    low, period = torch.tensor([0.1], dtype=dtype), torch.tensor([0.3], dtype=dtype)
    ends = (low + period * torch.arange(-50, 51)).unsqueeze(-1)
    beside = [torch.nextafter(ends, torch.full_like(ends, end)) for end in (-torch.inf, torch.inf)]
    wrapped = periods.wrap(torch.cat([ends, *beside]), low, period)
    assert ((wrapped >= low) & (wrapped < low + period)).all()


def test_differences_go_the_shortest_way():
    differences = torch.tensor([[-350.0, 350.0], [350.0, -350.0], [170.0, 0.0], [725.0, 1e9]], dtype=F64)
    assert periods.shortest(differences, PERIOD).tolist() == [[10, 350], [-10, -350], [170, 0], [5, 1e9]]


def test_nearest_stands_for_the_same_place():
    assert periods.nearest(first(-179.0, 5.0, 725.0), first(181.0), PERIOD)[:, 0].tolist() == [181, 5, 5]


@pytest.mark.parametrize("shift", [0.0, 100.0, 180.0, -175.0])
def test_moments_do_not_know_the_seam(shift):
    """A cloud across the seam, each point given on any turn, has the moments of the same cloud elsewhere."""
    generator = torch.Generator().manual_seed(3)
    cloud = 25 * torch.randn(200, 2, generator=generator, dtype=F64)
    log_weight = torch.randn(200, generator=generator, dtype=F64).log_softmax(-1)
    turns = torch.randint(-3, 4, (200,), generator=generator) * 360.0
    there = cloud + torch.stack([shift + turns, torch.zeros_like(turns)], -1)
    gathered = periods.gather(there, log_weight, LOW, PERIOD)
    centred = [points - log_weight.exp() @ points for points in (cloud, gathered)]
    torch.testing.assert_close(centred[1], centred[0])
    mean = log_weight.exp() @ gathered
    expected = periods.wrap(log_weight.exp() @ cloud + torch.tensor([shift, 0.0], dtype=F64), LOW, PERIOD)
    torch.testing.assert_close(mean, expected)


def test_a_cloud_around_the_whole_circle_stays_within_a_turn():
    points = torch.linspace(0, 1080, 301, dtype=F64)[:-1, None]
    log_weight = torch.full((300,), -math.log(300.0), dtype=F64)
    gathered = periods.gather(points, log_weight, LOW[:1], PERIOD[:1])
    assert gathered.amax() - gathered.amin() <= 360


def test_turns_are_constants_to_the_gradient():
    points = first(170.0, 190.0, 900.0).requires_grad_()
    for moved in (
        periods.wrap(points, LOW, PERIOD),
        periods.shortest(points, PERIOD),
        periods.gather(points, torch.full((3,), -math.log(3.0), dtype=F64), LOW, PERIOD),
    ):
        (gradient,) = torch.autograd.grad(moved.sum(), points)
        assert (gradient == 1).all()
