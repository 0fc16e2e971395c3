"""States that an array cannot tell apart: found by the field, refused where a region holds both."""

import pytest
import torch
from oracles.line_array import FREQS, POSITIONS

from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import InputError
from torchdt.field import LineArrayField, PlaneWaveField, SphericalWaveField
from torchdt.field.mismatch import MismatchedField
from torchdt.field.stacked import StackedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
GROUND = [[x, y, 0.0] for x in (0.0, 4.0) for y in (0.0, 3.0, 7.0)]
WALL = [[x, 2 * x, z] for x in (0.0, 4.0) for z in (0.0, 3.0, 7.0)]
BLOCK = [*GROUND, [1.0, 1.0, 3.0]]


def line() -> LineArrayField:
    return LineArrayField(FREQS, POSITIONS, dtype=F64)


def plane(places: list[list[float]], kind: str) -> PlaneWaveField:
    return PlaneWaveField(FREQS, places, 1500.0, kind, dtype=F64)


def sphere(places: list[list[float]], number: int) -> SphericalWaveField:
    return SphericalWaveField(FREQS, places, 1500.0, num_coordinates=number, plane_z=-5.0, dtype=F64)


FIELDS = {
    "line": (line, [[20.0], [-130.0]]),
    "bearing": (lambda: plane(GROUND, "bearing"), [[20.0], [-130.0]]),
    "elevation over ground": (lambda: plane(GROUND, "azimuth_elevation"), [[20.0, 30.0], [130.0, -60.0]]),
    "elevation beside a wall": (lambda: plane(WALL, "azimuth_elevation"), [[20.0, 30.0], [130.0, -60.0]]),
    "elevation": (lambda: plane(BLOCK, "azimuth_elevation"), [[20.0, 30.0], [130.0, -60.0]]),
    "cosines over ground": (lambda: plane(GROUND, "direction_cosines"), [[0.3, -0.5], [0.1, 0.2]]),
    "cosines beside a wall": (lambda: plane(WALL, "direction_cosines"), [[0.3, -0.5], [0.1, 0.2]]),
    "positions beside a wall": (lambda: sphere(WALL, 2), [[30.0, 5.0], [-6.0, 70.0]]),
    "positions in space": (lambda: sphere(WALL, 3), [[30.0, 5.0, 9.0], [-6.0, 70.0, -8.0]]),
    "positions around": (lambda: sphere(BLOCK, 3), [[30.0, 5.0, 9.0], [-6.0, 70.0, -8.0]]),
}
ONE_SIDED = {name for name in FIELDS if any(word in name for word in ("line", "wall", "space"))} | {
    "elevation over ground"
}


@pytest.mark.parametrize("name", FIELDS)
def test_images_have_the_same_response(name):
    """Also those a whole turn away; and across the sensors only where these are flat."""
    make, positions = FIELDS[name]
    field, state = make(), torch.tensor(positions, dtype=F64)
    vector = field.directions.vector if isinstance(field, PlaneWaveField) else torch.clone
    images = field.images(state)
    assert images.shape[1:] == state.shape
    expected = field(state)
    across = False
    for image in images:
        there = image.isfinite().all(-1)
        torch.testing.assert_close(field(image[there]), expected[there])
        across = across or bool(((vector(image) - vector(state)).abs().amax(-1) > 0.01)[there].any())
    assert across is (name in ONE_SIDED)


def coordinate(
    name: str, low: float, high: float, cell: float = 5.0, period: float | None = None
) -> Coordinate:
    return Coordinate(name, "deg", low, high, cell, -1.0, 1.0, 1e-3, period)


AZIMUTH = coordinate("azimuth", 0, 360)
BOXES = {
    "line, all around": (line, [coordinate("bearing", -180, 180)], False),
    "line, some of both sides": (line, [coordinate("bearing", 40, 110)], False),
    "line, front": (line, [coordinate("bearing", -90, 90)], True),
    "line, back": (line, [coordinate("bearing", 90, 270)], True),
    "one turn": (lambda: plane(GROUND, "bearing"), [coordinate("bearing", 0, 360)], True),
    "a closed turn": (lambda: plane(GROUND, "bearing"), [coordinate("bearing", -180, 180, 5, 360)], True),
    "line, a closed turn": (line, [coordinate("bearing", -180, 180, 5, 360)], False),
    "line, front and its seam": (line, [coordinate("bearing", 90, 270, 5, 360)], True),
    "more than one turn": (lambda: plane(GROUND, "bearing"), [coordinate("bearing", -20, 360)], False),
    "above ground": (lambda: plane(GROUND, "azimuth_elevation"), [AZIMUTH, coordinate("up", 0, 90)], True),
    "below ground": (lambda: plane(GROUND, "azimuth_elevation"), [AZIMUTH, coordinate("up", -90, 0)], True),
    "up and down": (lambda: plane(GROUND, "azimuth_elevation"), [AZIMUTH, coordinate("up", -30, 60)], False),
    "up and down, a block": (
        lambda: plane(BLOCK, "azimuth_elevation"),
        [AZIMUTH, coordinate("up", -90, 90)],
        True,
    ),
    "over the zenith": (
        lambda: plane(BLOCK, "azimuth_elevation"),
        [AZIMUTH, coordinate("up", 60, 120)],
        False,
    ),
    "sky over ground": (
        lambda: plane(GROUND, "direction_cosines"),
        [coordinate(name, -1, 1, 0.1) for name in "en"],
        True,
    ),
    "sky beside a wall": (
        lambda: plane(WALL, "direction_cosines"),
        [coordinate(name, -1, 1, 0.1) for name in "en"],
        False,
    ),
    "both sides of a wall": (lambda: sphere(WALL, 2), [coordinate(name, -50, 50) for name in "xy"], False),
    "one side of a wall": (
        lambda: sphere(WALL, 2),
        [coordinate("x", 30, 50), coordinate("y", -50, 0)],
        True,
    ),
    "over and under ground": (
        lambda: sphere(GROUND, 3),
        [coordinate(name, -20, 20) for name in "xyz"],
        False,
    ),
    "over ground": (
        lambda: sphere(GROUND, 3),
        [*(coordinate(name, -20, 20) for name in "xy"), coordinate("z", 0, 20)],
        True,
    ),
}


@pytest.mark.parametrize("name", BOXES)
def test_a_region_holds_one_of_both(name):
    make, coordinates, holds = BOXES[name]
    field, region = make(), Region(coordinates, F64)
    wrapped = MismatchedField(StackedField([field, field]), torch.full((2,), 0.1, dtype=F64))
    config = TrackerConfig(slots=2, particles=10)
    for one in (field, wrapped):
        for build in (
            lambda f: DirectTracker(f, region, 1.0, config),
            lambda f: TwoStepTracker(f, region, 1.0, TwoStepConfig(slots=2, particles=10)),
        ):
            if holds:
                assert build(one).region.num_cells > 0
            else:
                with pytest.raises(InputError, match="which the sensors cannot tell apart"):
                    build(one)


def test_a_period_is_that_of_the_field():
    box = Region([coordinate("bearing", 0, 90, 5, 180)], F64)
    with pytest.raises(InputError, match=r"bearing\.period': found 180, expected one after which the field"):
        box.within(plane(GROUND, "bearing"))


def test_both_places_are_named():
    with pytest.raises(InputError) as error:
        DirectTracker(line(), Region([coordinate("bearing", -180, 180)], F64), 1.0, TrackerConfig())
    assert "holds both bearing -177.5 deg and bearing -2.5 deg" in str(error.value)


@pytest.mark.parametrize("places", [[[0.0, 5.0 * m, 0.0] for m in range(8)], [*WALL, [8.0, 16.0, 1.0]]])
def test_bearings_all_around_need_two_horizontal_dimensions(places):
    """A line, or a wall, hears a source at 320 degrees as one at 40."""
    with pytest.raises(InputError, match="span 1 horizontal dimensions, expected 2 or more"):
        PlaneWaveField(FREQS, places, 1500.0, "bearing")
