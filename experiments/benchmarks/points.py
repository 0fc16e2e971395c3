"""Time of conventional tracking, as points come in."""

from functools import partial
from statistics import fmean, median, quantiles

import torch

from benchmarks.clock import clock
from benchmarks.report import Measured
from torchdt.baselines.detect.points import Points
from torchdt.baselines.mot.config import PointConfig
from torchdt.baselines.mot.likelihood import GaussianPosition
from torchdt.baselines.mot.tracker import PointTracker
from torchdt.core.random import RandomStreams
from torchdt.model.region import Coordinate, Region

OBJECTS, FALSE, WARM_UP, TIMED = 5, 5, 10, 30
"""Objects, false points per step, steps before and while the clock runs."""


def measure_points(particles: int, repeats: int, device: str) -> list[Measured]:
    """Conventional tracking of 5 objects from 10 points per step.

    Args:
        particles: of each object.
        repeats: scenes, of seeds from 0 up.
        device: of the tracker.
    """
    region = Region(
        [Coordinate(name, "m", 0.0, 1000.0, 20.0, -5.0, 5.0, 0.05) for name in ("x", "y")],
        torch.float32,
        device,
    )
    config = PointConfig(particles=particles, clutter_mean=FALSE)
    tracker = PointTracker(region, 1.0, config, GaussianPosition(region))
    seconds, declared, carried = [], [], []
    for seed in range(repeats):
        points = simulate_points(tracker, seed)
        streams = RandomStreams.from_seeds([seed], (), torch.float32, device)
        state = tracker.init((), 1)
        for k in range(len(points.present)):
            step = Points(*(t[k] for t in points))
            with torch.inference_mode():
                taken, (state, history) = clock(partial(tracker.step, state, step, streams), device)
            if k >= WARM_UP:
                seconds.append(taken)
                declared.append(int(history.declared.sum()))
                carried.append(int((history.existence > 0).sum()))
    size = f"{particles} particles, {config.slots} slots, {OBJECTS + FALSE} points per step"
    slow = 1e3 * quantiles(seconds, n=10)[-1]
    rows: list[tuple[str, float, str, str]] = [
        ("torchdt", 1e3 * median(seconds), "ms/step", f"{size}; median of {len(seconds)} steps"),
        ("torchdt, nine of ten steps", slow, "ms/step", "or less"),
        ("objects carried", fmean(carried), "per step", f"of {config.slots}"),
        ("objects declared", fmean(declared), "per step", f"there are {OBJECTS}"),
    ]
    return [Measured("points", *row) for row in rows]


def simulate_points(tracker: PointTracker, seed: int) -> Points:
    """Points `(K, Q)` of objects at constant rates, all of which are found, and of clutter.

    The first `OBJECTS` of the Q points are those of the objects.
    """
    region, spread = tracker.region, GaussianPosition(tracker.region).spread
    streams = RandomStreams.from_seeds([seed], (), region.low.dtype, region.low.device)
    # Who starts in the middle half of the region does not leave it in so many steps.
    num_steps = WARM_UP + TIMED
    start = torch.lerp(region.low, region.high, 0.25 + 0.5 * streams.uniform(OBJECTS, 2))
    rate = torch.lerp(region.rate_low, region.rate_high, streams.uniform(OBJECTS, 2))
    time_s = tracker.step_s * torch.arange(num_steps, device=start.device)[:, None, None]
    found = start + time_s * rate + spread * streams.normal(num_steps, OBJECTS, 2)
    false = torch.lerp(region.low, region.high, streams.uniform(num_steps, FALSE, 2))
    position = torch.cat([found, false], 1)
    strength = torch.ones_like(position[..., 0])
    return Points(position, strength, strength[..., None], strength > 0, strength[:, :1])
