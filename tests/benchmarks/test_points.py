import math

import pytest
import torch

from benchmarks.points import FALSE, OBJECTS, TIMED, WARM_UP, measure_points, simulate_points
from torchdt.baselines.mot.config import PointConfig
from torchdt.baselines.mot.likelihood import GaussianPosition
from torchdt.baselines.mot.tracker import PointTracker
from torchdt.model.region import Coordinate, Region

pytestmark = pytest.mark.slow


def test_points_are_tracked_while_the_clock_runs():
    rows = measure_points(200, 2, "cpu")
    values = {row.quantity: row.value for row in rows}
    assert values["objects declared"] == pytest.approx(OBJECTS, abs=0.5)
    assert OBJECTS < values["objects carried"] <= PointConfig().slots
    assert 0 < values["torchdt"] <= values["torchdt, nine of ten steps"] < math.inf
    assert rows[0].note.startswith("200 particles, ")
    assert rows[0].note.endswith(f"median of {2 * TIMED} steps")


def test_points_follow_objects_that_stay_in_the_region():
    coordinates = [Coordinate(name, "m", 0.0, 1000.0, 20.0, -5.0, 5.0, 0.05) for name in "xy"]
    region = Region(coordinates, torch.float64)
    tracker = PointTracker(region, 1.0, PointConfig(particles=10), GaussianPosition(region))
    points = simulate_points(tracker, 0)
    assert points.position.shape == (WARM_UP + TIMED, OBJECTS + FALSE, 2)
    assert points.present.all()
    assert region.contains(points.position).all()
    # Of noise of variance 100 the mean of 380 squared second differences is 600, with standard deviation 61;
    # of clutter it is 5e5.
    bend = points.position.diff(n=2, dim=0).square()
    assert 300 < bend[:, :OBJECTS].mean() < 1000
    assert bend[:, OBJECTS:].mean() > 1e5
    assert not torch.equal(simulate_points(tracker, 1).position, points.position)
