"""Objects outside what is reported are tracked all the same."""

from dataclasses import replace

import torch
from oracles.line_array import BEARING, SMALL, make_field, simulate

from torchdt.core.random import RandomStreams
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.measurement import from_snapshots
from torchdt.model.prior import data_priors
from torchdt.model.region import Coordinate, Region

PATHS = (((0.0, -30.0), (20.0, -30.0)), ((0.0, 30.0), (20.0, 10.0)))


def run(coordinate: Coordinate):
    data, _ = simulate(3, *PATHS)
    measurement = from_snapshots(data[None])
    tracker = DirectTracker(make_field(), Region([coordinate], torch.float64), 1.0, TrackerConfig(**SMALL))
    streams = RandomStreams.from_seeds([1], (1,), torch.float64)
    with torch.inference_mode():
        return tracker.run(measurement, data_priors(measurement), streams)


def test_all_is_tracked_and_a_part_reported():
    """The estimates are those of a region that is reported as a whole; labels do not change at the limit."""
    whole = Coordinate(**BEARING)
    every, some = run(whole), run(replace(whole, report_low=0.0, report_high=20.0))
    torch.testing.assert_close(some.existence, every.existence, rtol=0, atol=0)
    inside = (every.position[..., 0] >= 0) & (every.position[..., 0] <= 20)
    assert torch.equal(some.declared, every.declared & inside)
    assert torch.equal(some.label, every.label)
    assert every.declared[:, 5:].sum(-1).eq(2).all()
    assert some.declared[0, 5].sum() == 0
    assert some.declared[0, -1].sum() == 1
