"""A tracker of points in a rectangle, four objects for it, and what its results are held to."""

from collections.abc import Sequence

import torch
from oracles.points import Path, make_region, simulate, stacked, true_positions
from torch import Tensor

from torchdt.baselines.detect.points import Points
from torchdt.baselines.mot.config import PointConfig
from torchdt.baselines.mot.likelihood import GaussianPosition, PointLikelihood
from torchdt.baselines.mot.tracker import PointState, PointTracker
from torchdt.core.random import RandomStreams
from torchdt.filter.history import TrackHistory

F64 = torch.float64
SPREAD = [10.0, 5.0]
STEPS = 40
PATHS = (
    Path(0, 40, (100.0, 0.0), (6.0, 2.0)),
    Path(5, 40, (900.0, 50.0), (-7.0, 1.0)),
    Path(0, 25, (500.0, 300.0), (2.0, -3.0)),
    Path(12, 32, (300.0, -50.0), (0.0, 4.0)),
)
NOTHING = torch.full((STEPS, 1, 2), torch.nan, dtype=F64)
SCENE = {"spread": SPREAD, "detection_probability": 0.9, "clutter_mean": 2.0}
MODEL = {
    "detection_probability": 0.9,
    "clutter_mean": 2.0,
    "survival": 0.99,
    "birth_mean": 0.01,
    "prune": 1e-4,
}


def make_tracker(
    dtype: torch.dtype = F64, likelihood: PointLikelihood | None = None, **config
) -> PointTracker:
    region = make_region(dtype)
    settings = PointConfig(**({"slots": 12, "particles": 300} | MODEL | config))
    return PointTracker(region, 1.0, settings, likelihood or GaussianPosition(region, SPREAD))


def run(
    tracker: PointTracker, points: Points, seeds: Sequence[int], state: PointState | None = None
) -> tuple[PointState, TrackHistory]:
    """Track points of batch `(B, K)`."""
    streams = RandomStreams.from_seeds(seeds, (len(seeds),), points.position.dtype)
    state = tracker.init((len(seeds),), 1) if state is None else state
    steps = []
    for k in range(points.present.shape[1]):
        state, estimate = tracker.step(state, Points(*(t[:, k] for t in points)), streams)
        steps.append(estimate)
    return state, TrackHistory.of_steps(steps, 1)


def scene(seeds: Sequence[int], dtype: torch.dtype = F64) -> Points:
    return stacked([simulate(s, true_positions(STEPS, PATHS), **SCENE, dtype=dtype) for s in seeds])


def assert_sound(state: PointState, history: TrackHistory) -> None:
    """What holds for every history, whatever the points."""
    for name, values in history._asdict().items():
        if name != "log_evidence":
            assert values.double().isfinite().all(), name
    assert history.log_evidence.isnan().all()
    assert ((history.existence >= 0) & (history.existence <= 1)).all()
    assert history.existence.diff(dim=-1).le(0).all()
    assert (history.label[history.declared] > 0).all()
    assert history.label[history.existence == 0].eq(0).all()
    for labels in history.label.flatten(0, -2):
        named = labels[labels > 0].tolist()
        assert len(set(named)) == len(named), "one label, one slot"
    assert not any(t.isnan().any() for t in state.objects)
    assert state.objects.particles.isfinite().all()
    total = state.objects.log_weight.exp().sum(-1)
    torch.testing.assert_close(total, torch.ones_like(total))


def with_one_object(
    tracker: PointTracker, mean: Tensor, deviation: Tensor, log_odds: float, seeds: Sequence[int]
) -> PointState:
    """A state that holds one object with a Gaussian belief, of label 1."""
    state = tracker.init((len(seeds),), 1)
    objects = state.objects
    draws = RandomStreams.from_seeds(seeds, (len(seeds),), mean.dtype).normal(*objects.particles.shape[-2:])
    particles, odds, label = objects.particles.clone(), objects.log_odds.clone(), objects.label.clone()
    particles[:, 0], odds[:, 0], label[:, 0] = mean + deviation * draws, log_odds, 1
    objects = objects._replace(particles=particles, log_odds=odds, label=label)
    return PointState(objects, state.next_label + 1)
