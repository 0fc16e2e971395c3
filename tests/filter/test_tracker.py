"""What every tracker has from the protocol: tracking step by step, and of whole sequences."""

import gc
from collections.abc import Iterator

import pytest
import torch
from oracles.line_array import SMALL_PAPER, make_field, make_region, make_tracker, simulate
from torch import Tensor

from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.random import RandomStreams
from torchdt.filter.history import TrackHistory
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.tracker import PaperTracker
from torchdt.filter.tracker import Tracker
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.prior import Priors, data_priors

TWO = (((0.0, -40.0), (20.0, -25.0)), ((0.0, 30.0), (20.0, 20.0)))
STEPS = 8
KINDS = ("direct", "paper", "two_step")
each = pytest.mark.parametrize("kind", KINDS)


def build(kind: str) -> Tracker:
    if kind == "direct":
        return make_tracker()
    if kind == "paper":
        return PaperTracker(make_field(), make_region(), 1.0, PaperConfig(**SMALL_PAPER))
    config = TwoStepConfig(slots=4, particles=200, detector=PursuitConfig(points=4))
    return TwoStepTracker(make_field(), make_region(), 1.0, config)


def streams(number: int = 2) -> RandomStreams:
    return RandomStreams.from_seeds(range(number), (number,), torch.float64)


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return from_snapshots(torch.stack([simulate(seed, *TWO, steps=STEPS)[0] for seed in range(2)]))


@each
def test_a_stream_gives_the_steps_of_a_run(kind, measurement):
    tracker, priors = build(kind), data_priors(measurement)
    history = tracker.run(measurement, priors, streams())
    steps = list(tracker.stream((measurement.at(k) for k in range(STEPS)), priors, streams()))
    assert history.declared[:, -1].sum(-1).tolist() == [2, 2]
    for found, expected in zip(TrackHistory.of_steps(steps, 1), history, strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)


@each
def test_a_stream_waits_for_the_data(kind, measurement):
    """The estimates of a step are there before the next step is asked for."""
    asked = []

    def arrive() -> Iterator[Measurement]:
        for k in range(3):
            asked.append(k)
            yield measurement.at(k)

    stream = build(kind).stream(arrive(), data_priors(measurement), streams())
    assert asked == []
    for k in range(3):
        assert next(stream).existence.shape == (2, 4)
        assert asked == list(range(k + 1))
    assert next(stream, None) is None


@pytest.mark.slow
@each
@torch.inference_mode()
def test_a_stream_keeps_nothing(kind, measurement):
    """As many tensors are alive after 20 steps as after five."""
    alive = []
    endless = (Measurement(*(t[:, k % STEPS].clone() for t in measurement)) for k in range(20))
    priors = Priors(*data_priors(measurement))
    for k, _ in enumerate(build(kind).stream(endless, priors, streams())):
        if k in (5, 19):
            gc.collect()
            alive.append(sum(issubclass(type(thing), Tensor) for thing in gc.get_objects()))
    assert alive[0] == alive[1]


@each
def test_a_run_reports_every_step(kind, measurement):
    reported = []
    history = build(kind).run(
        measurement,
        data_priors(measurement),
        streams(),
        lambda k, _, estimate: reported.append((k, estimate)),
    )
    assert [k for k, _ in reported] == list(range(STEPS))
    assert all(torch.equal(estimate.label, history.label[:, k]) for k, estimate in reported)
