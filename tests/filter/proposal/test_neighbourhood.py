"""Boxes of new objects: their size, and what belongs to which."""

import math

import pytest
import torch
from torch import Tensor

from torchdt.core.importance import Box, Gaussian
from torchdt.core.random import RandomStreams
from torchdt.filter.proposal.neighbourhood import cell_around, drop_foreign, grow, log_cells, place_of
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
REGION = Region(
    [Coordinate("range", "m", 0, 1600, 10, -1, 1, 1e-2), Coordinate("depth", "m", 0, 100, 2, -1, 1, 1e-5)],
    F64,
)


def grown(width: Tensor, peak: Tensor, seeds: list[int]) -> Box:
    """Boxes of Gaussian likelihoods `(B, 2)`, thrown off the peak by a quarter of their width."""

    def log_likelihood(points: Tensor) -> Tensor:
        return -0.5 * ((points - (peak + 0.25 * width)[:, None]) / width[:, None]).square().sum(-1)

    rounds = RandomStreams.from_seeds(seeds, (len(seeds),), F64).normal(4, 128, 2).movedim(1, 0)
    return grow(log_likelihood, peak, REGION, rounds)


WIDTHS = torch.tensor([[1e-4, 1e-4], [40.0, 0.01], [0.01, 8.0], [30.0, 6.0], [1e9, 1e9]], dtype=F64)
PEAK = torch.tensor([[800.0, 51.0]] * 5, dtype=F64)


def test_boxes_hold_their_likelihoods_and_not_much_more():
    """A likelihood of one cell or less keeps one; else the box ends between 4 and 21 deviations."""
    box = grown(WIDTHS, PEAK, [1, 2, 3, 4, 5])
    half = (box.high - box.low) / 2
    assert half[0].tolist() == [5.0, 1.0]
    assert half[1, 1] == half[0, 1]
    assert half[2, 0] == half[0, 0]
    for wide, axis in ((1, 0), (2, 1), (3, 0), (3, 1)):
        assert 4 * WIDTHS[wide, axis] <= half[wide, axis] <= 21 * WIDTHS[wide, axis]
    torch.testing.assert_close(box.low[4], REGION.low)
    torch.testing.assert_close(box.high[4], REGION.high)
    torch.testing.assert_close(log_cells(box, REGION)[[0, 4]].exp(), torch.tensor([1.0, 160 * 50], dtype=F64))


@pytest.mark.parametrize("b", range(5))
def test_a_box_does_not_depend_on_the_others_of_a_batch(b):
    together, one = grown(WIDTHS, PEAK, [1, 2, 3, 4, 5]), slice(b, b + 1)
    alone = grown(WIDTHS[one], PEAK[one], [b + 1])
    for corner, expected in zip(together, alone, strict=True):
        torch.testing.assert_close(corner[one], expected)


def test_boxes_end_at_the_region():
    corner = torch.tensor([[3.0, 99.5]], dtype=F64)
    box = grown(torch.tensor([[1e-4, 1e-4]], dtype=F64), corner, [1])
    assert box.low.tolist() == [[0.0, 98.5]]
    assert box.high.tolist() == [[8.0, 100.0]]


def test_no_place_counts_for_two():
    """Three picks: a blunt one, a sharp one within it, and one that is not active."""
    mean = torch.tensor([[10.0], [11.0], [10.5]], dtype=F64)
    tril = torch.tensor([2.0, 0.1, 0.01], dtype=F64)[:, None, None]
    boxes = Box(torch.full_like(mean, 5.0), torch.full_like(mean, 15.0))
    places = place_of(Gaussian(mean, tril), boxes)
    torch.testing.assert_close(places.low[:, 0], torch.tensor([5.0, 10.7, 10.47], dtype=F64))
    torch.testing.assert_close(places.high[:, 0], torch.tensor([15.0, 11.3, 10.53], dtype=F64))
    points = torch.linspace(4, 16, 121, dtype=F64)[:, None].expand(3, -1, -1)
    active = torch.tensor([True, True, False])
    kept = drop_foreign(points, torch.zeros(3, 121, dtype=F64), places, active, REGION).eq(0)
    x = points[0, :, 0]
    sharp = (x > 10.69) & (x < 11.31)
    assert torch.equal(kept[1][(x >= 5) & (x <= 15)], sharp[(x >= 5) & (x <= 15)])
    assert torch.equal(kept[0], ~sharp)
    inside = (x >= 5) & (x <= 15)
    assert (kept[:2, inside].sum(0) == 1).all()


def test_a_pick_found_twice_counts_once():
    """Of equal places the first has all, whatever the order of its particles; batches in front."""
    mean = torch.zeros(2, 3, 2, dtype=F64)
    tril = torch.eye(2, dtype=F64).expand(2, 3, -1, -1)
    boxes = Box(mean - 5, mean + 5)
    points = torch.randn(2, 3, 40, 2, generator=torch.Generator().manual_seed(1), dtype=F64).clamp(-2.9, 2.9)
    active = torch.ones(2, 3, dtype=torch.bool)
    kept = drop_foreign(
        points, torch.zeros(2, 3, 40, dtype=F64), place_of(Gaussian(mean, tril), boxes), active, REGION
    )
    assert kept[:, 0].eq(0).all()
    assert kept[:, 1:].eq(-math.inf).all()


AROUND = Region([Coordinate("azimuth", "deg", -180, 180, 5, -1, 1, 1e-2, 360)], F64)


def test_a_box_goes_on_behind_the_seam_and_ends_after_one_period():
    """A narrow likelihood next to the seam, and one that says nothing."""
    peak, width = torch.tensor([[179.0], [179.0]], dtype=F64), torch.tensor([[1e-3], [1e9]], dtype=F64)

    def log_likelihood(points: Tensor) -> Tensor:
        return -0.5 * (AROUND.difference(points, peak[:, None]) / width[:, None]).square().sum(-1)

    rounds = RandomStreams.from_seeds([1, 2], (2,), F64).normal(4, 128, 1).movedim(1, 0)
    box = grow(log_likelihood, peak, AROUND, rounds)
    assert box.low[:, 0].tolist() == [176.5, -1.0]
    assert box.high[:, 0].tolist() == [181.5, 359.0]
    torch.testing.assert_close(log_cells(box, AROUND).exp(), torch.tensor([1.0, 72.0], dtype=F64))
    assert cell_around(peak, AROUND).high[0].item() == 181.5


def test_a_place_counts_once_on_whatever_turn_it_is():
    """Both see an object across the seam, one from each side: the sharper one has what both hold."""
    boxes = Box(torch.tensor([[170.0], [-182.0]], dtype=F64), torch.tensor([[190.0], [-178.0]], dtype=F64))
    points = torch.tensor([175.0, 179.0, 181.0, 185.0], dtype=F64)[:, None]
    points = torch.stack([points, points - 360])
    active = torch.ones(2, dtype=torch.bool)
    kept = drop_foreign(points, torch.zeros(2, 4, dtype=F64), boxes, active, AROUND).eq(0)
    assert kept[0].tolist() == [True, False, False, True]
    assert kept[1, 1:3].all()
