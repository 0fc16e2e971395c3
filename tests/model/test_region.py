import math
from dataclasses import replace

import pytest
import torch
from oracles.waveguide import make_field

from torchdt.core.errors import InputError
from torchdt.model.region import Coordinate, Region

RANGE = Coordinate("range", "m", 1000.0, 1100.0, 25.0, -4.0, 4.0, 1e-2)
DEPTH = Coordinate("depth", "m", 5.0, 11.0, 2.0, -1.0, 1.0, 1e-5)


def test_cells_tile_the_region():
    region = Region([RANGE, DEPTH], torch.float64)
    centres = region.cell_centres()
    assert region.num_cells == len(centres) == 12
    assert region.grid_shape == (4, 3)
    assert region.cell.tolist() == [25.0, 2.0]
    assert centres[:4].tolist() == [[1012.5, 6.0], [1012.5, 8.0], [1012.5, 10.0], [1037.5, 6.0]]
    assert centres.mean(0).tolist() == [1050.0, 8.0]
    assert region.contains(centres).all()


def test_a_whole_number_of_cells_survives_rounding():
    assert Region([Coordinate("range", "m", 0.0, 0.3, 0.1, -1, 1, 1.0)]).num_cells == 3  # 0.3 / 0.1 < 3


def test_cells_are_stretched_to_a_whole_number():
    region = Region([Coordinate("range", "m", 0.0, 100.0, 30.0, -1, 1, 1.0)])
    assert region.num_cells == 3
    assert region.cell.item() == pytest.approx(100 / 3)


def test_contains_reads_positions_only():
    region = Region([RANGE, DEPTH])
    states = torch.tensor(
        [[1050.0, 7.0, 99.0, 99.0], [999.0, 7.0, 0, 0], [1050.0, 11.5, 0, 0], [1000.0, 5.0, 0, 0]]
    )
    assert region.contains(states).tolist() == [True, False, False, True]


def test_only_what_is_asked_for_is_reported():
    region = Region([replace(RANGE, report_low=1025.0, report_high=1050.0), DEPTH], torch.float64)
    positions = torch.tensor(
        [[1024.0, 7.0], [1025.0, 7.0], [1050.0, 5.0], [1051.0, 7.0]], dtype=torch.float64
    )
    assert region.contains(positions).all()
    assert region.reports(positions).tolist() == [False, True, True, False]
    assert Region([RANGE, DEPTH], torch.float64).reports(positions).all()


@pytest.mark.parametrize(
    ("low", "high", "key"),
    [(999.0, None, "report_low"), (None, 1101.0, "report_high"), (1050.0, 1050.0, "report_high")],
)
def test_limits_of_what_is_reported_lie_in_the_region(low, high, key):
    with pytest.raises(InputError, match=rf"scenario.coordinates.range.{key}"):
        replace(RANGE, report_low=low, report_high=high)


def test_column_names():
    assert Region([RANGE, DEPTH]).column_names == ("range_m", "depth_m", "range_rate_mps", "depth_rate_mps")


class Disc:
    """A field whose objects are in the unit circle."""

    num_tones, num_sensors, num_coordinates = 1, 1, 2

    def __call__(self, state):
        return torch.ones(*state.shape[:-1], 1, 1, dtype=torch.complex128)

    def inside(self, state):
        return state[..., :2].square().sum(-1) <= 1


def square(low, high, cell):
    edges = [Coordinate(name, "", low, high, cell, -1, 1, 1.0) for name in "en"]
    return Region(edges, torch.float64)


def test_region_within_a_bounded_field():
    box = square(-1.0, 1.0, 0.1)
    region = box.within(Disc())
    states = torch.tensor([[0.6, 0.7, 9.0, 9.0], [0.8, 0.7, 0.0, 0.0], [-0.1, 1.05, 0.0, 0.0]])
    assert region.contains(states).tolist() == [True, False, False]
    assert box.contains(states).tolist() == [True, True, False]
    assert (region.grid_shape, region.low.dtype) == (box.grid_shape, torch.float64)
    assert torch.equal(region.cell_centres(), box.cell_centres())
    assert torch.equal(region.within(Disc()).is_birth_cell, region.is_birth_cell)


@pytest.mark.parametrize(("high", "number"), [(1.25, 7), (1.25, 20), (1.25, 41), (7 * 0.1998, 7)])
def test_birth_cells_reach_into_the_circle(high, number):
    """Those whose nearest point to the origin is in it: in the last grid the middle of a side, at 0.999."""
    region = square(-high, high, 2 * high / number).within(Disc())
    nearest = (region.cell_centres().abs() - region.cell / 2).clamp(min=0)
    expected = nearest.square().sum(-1) <= 1
    assert torch.equal(region.is_birth_cell, expected)
    assert region.num_cells == int(expected.sum()) < number**2


def test_without_a_bound_all_cells_are_birth_cells():
    region = Region([RANGE, DEPTH], torch.float64)
    states = torch.tensor([[1050.0, 10.0], [1.0, 1.0]], dtype=torch.float64)
    for one in (region, region.within(make_field(torch.float64))):
        assert one.is_birth_cell.tolist() == [True] * 12
        assert one.contains(states).tolist() == [True, False]


def test_region_without_room_is_refused():
    with pytest.raises(InputError, match=r"'scenario.coordinates': found 4 cells, none of them"):
        square(0.9, 1.1, 0.1).within(Disc())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"low": 1100.0}, "low': found 1100.0, expected a number below high, 1100.0"),
        ({"low": -math.inf}, "low': found -inf, expected a finite number"),
        ({"rate_low": 5.0}, "rate_low': found 5.0, expected a number below rate_high, 4.0"),
        ({"cell": 0.0}, "cell': found 0.0, expected a positive number"),
        ({"cell": 101.0}, "cell': found 101.0, expected at most the region's width, 100.0"),
        ({"cell": 1e-12}, "cell': found 1e-12, expected at least 1e-05, a region of fewer cells"),
        ({"driving_variance": 0.0}, "driving_variance': found 0.0, expected a positive number"),
    ],
)
def test_wrong_coordinates_are_named(change, message):
    with pytest.raises(InputError, match=f"key 'scenario.coordinates.range.{message}"):
        Coordinate(**(RANGE.__dict__ | change))


def test_cells_of_all_coordinates_are_limited():
    fine = Coordinate("range", "m", 0.0, 1.0, 1e-4, -1.0, 1.0, 1.0)
    with pytest.raises(InputError, match="found 100000000 cells, expected at most 10000000"):
        Region([fine, replace(fine, name="depth")])


AZIMUTH = Coordinate("azimuth", "deg", -180.0, 180.0, 5.0, -1.0, 1.0, 1e-3, period=360.0)


def test_a_region_of_a_whole_period_has_no_ends():
    region = Region([AZIMUTH, DEPTH], torch.float64)
    states = torch.tensor([[190.0, 7.0, 9.0, 9.0], [-999.0, 7.0, 0, 0], [190.0, 12.0, 0, 0]])
    assert region.contains(states).tolist() == [True, True, False]
    assert region.wrap(states).tolist() == [[-170, 7, 9, 9], [81, 7, 0, 0], [-170, 12, 0, 0]]
    ends = [[-math.inf, 5.0], [math.inf, 11.0]]
    assert [region.lower_end.tolist(), region.upper_end.tolist()] == ends
    assert region.difference(*torch.tensor([[179.0, 6.0], [-179.0, 10.0]])).tolist() == [-2.0, -4.0]


def test_a_sector_across_the_seam_has_ends():
    """From 150 to 230 degrees, whatever turn a position is given on."""
    region = Region([replace(AZIMUTH, low=150.0, high=230.0)], torch.float64)
    states = torch.tensor([[-170.0], [160.0 + 720], [140.0], [-129.0]])
    assert region.contains(states).tolist() == [True, True, False, False]
    assert region.wrap(states)[:2].tolist() == [[190.0], [160.0]]


def test_particles_of_a_cloud_are_gathered_with_their_rates():
    region = Region([AZIMUTH], torch.float64)
    state = torch.tensor([[[179.0, 1.0], [-177.0, 2.0]]], dtype=torch.float64)
    log_weight = torch.full((1, 2), -math.log(2.0), dtype=torch.float64)
    gathered = region.gather(state, log_weight)
    assert gathered.mean(-2).tolist() == [[-179.0, 1.5]]
    assert gathered[0, :, 0].diff().item() == 4.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period": 300.0}, "expected at least the region's width, 360.0, or null"),
        ({"period": -1.0}, "expected a positive number"),
        ({"period": math.nan}, "expected a positive number"),
    ],
)
def test_wrong_periods_are_named(change, message):
    with pytest.raises(InputError, match=f"key 'scenario.coordinates.azimuth.period': found .*{message}"):
        replace(AZIMUTH, **change)
