"""Detection and tracking of points on a line array, with either detector."""

import math
import re

import pytest
import torch
from oracles.arrays import sample_covariance
from oracles.line_array import FREQS, POSITIONS, make_field, make_region, simulate
from oracles.line_array import make_tracker as make_direct_tracker
from oracles.point_tracking import assert_sound
from torch import Tensor

from torchdt.baselines.detect.config import DetectorConfig, PursuitConfig, SblConfig
from torchdt.baselines.detect.pursuit import MatchingPursuit
from torchdt.baselines.detect.sbl import SparseBayesianLearning
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker, build_detector
from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.data.recording import Recording, validate
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.history import TrackHistory
from torchdt.filter.tracker import Tracker
from torchdt.metrics import gospa
from torchdt.model.measurement import from_snapshots
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.prior import data_priors
from torchdt.run.track import track

pytestmark = pytest.mark.slow
TWO = (((0.0, -40.0), (20.0, -25.0)), ((0.0, 30.0), (20.0, 20.0)))
ONE = (((0.0, 5.0), (20.0, 12.0)),)
# Two tones in three snapshots say little: a single step leaves a source at 10 to 20 nats.
DETECTORS = {
    "mp": PursuitConfig(points=4, threshold=8.0),
    "sbl": SblConfig(points=4, threshold=8.0, max_iterations=20),
}
DETECTION, SURVIVAL = 0.9, 0.95
MODEL = {
    "slots": 6,
    "particles": 200,
    "survival": SURVIVAL,
    "birth_mean": 1e-2,
    "prune": 1e-4,
    "detection_probability": DETECTION,
    "clutter_mean": 1.0,
    "spread": {"bearing": 0.5},
}
TOLERANCE = {
    torch.float64: {"rtol": 1e-6, "atol": 1e-6},
    torch.float32: {"rtol": 2e-3, "atol": 2e-3},
}
SEEDS = (5, 6, 7)
either = pytest.mark.parametrize("detector", DETECTORS)


def make_tracker(kind: str, dtype: torch.dtype = torch.float64, field=None, **config) -> TwoStepTracker:
    settings = TwoStepConfig(**({"detector": DETECTORS[kind]} | MODEL | config))
    return TwoStepTracker(field or make_field(dtype), make_region(dtype), 1.0, settings)


def record(snapshots: Tensor) -> Recording:
    return validate(step_s=1.0, snapshots=snapshots)


def assert_same(found: TrackHistory, expected: TrackHistory, rtol: float, atol: float) -> None:
    """Equal estimates of every object; slots without an object hold no information."""
    assert torch.equal(found.declared, expected.declared)
    assert expected.declared.any()
    alive = expected.existence > 0
    assert torch.equal(found.label[alive], expected.label[alive])
    for name in ("existence", "noise"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=rtol, atol=atol)
    for name in ("state", "state_std", "power"):
        values = getattr(found, name)[alive], getattr(expected, name)[alive]
        torch.testing.assert_close(*values, rtol=rtol, atol=atol)


def labels_at(history: TrackHistory, step: int, run: int = 0) -> set[int]:
    return set(history.label[run, step][history.declared[run, step]].tolist())


@pytest.fixture(scope="module")
def mixed() -> Tensor:
    """Three sequences of ten steps: two sources, one that falls silent half-way, noise."""
    sequences = [simulate(11, *TWO)[0], simulate(14, *ONE)[0], simulate(2)[0]]
    sequences[1][5:] = simulate(5)[0][5:]
    return torch.stack(sequences)[:, :10]


@pytest.fixture(scope="module")
def tracked(mixed) -> dict[str, TrackHistory]:
    """What either detector leads to, in double precision."""
    return {name: track(record(mixed), make_tracker(name), SEEDS) for name in DETECTORS}


@either
@pytest.mark.parametrize("dtype", TOLERANCE)
def test_two_sources_are_found_and_keep_their_labels(detector, dtype):
    """Within a degree on average once two detections each have confirmed them; 10 with nothing declared."""
    seeds = [1, 2]
    data, truth = (
        torch.stack(part)[:, :12] for part in zip(*(simulate(s, *TWO) for s in seeds), strict=True)
    )
    recording = validate(step_s=1.0, snapshots=data, truth=truth)
    history = track(recording, make_tracker(detector, dtype), seeds)
    assert history.state.dtype == dtype
    score = gospa(history.position.double(), history.declared, recording.truth, recording.truth_mask, 10.0)
    assert (score.total[:, 3:].mean(-1) < 1).all(), score.total
    for b in range(len(seeds)):
        assert {len(labels_at(history, k, b)) for k in range(3, 12)} == {2}
        assert len(set.union(*(labels_at(history, k, b) for k in range(3, 12)))) == 2


@either
@pytest.mark.parametrize("dtype", TOLERANCE)
def test_a_batch_equals_single_runs(mixed, tracked, detector, dtype):
    tracker = make_tracker(detector, dtype)
    together = tracked[detector] if dtype == torch.float64 else track(record(mixed), tracker, SEEDS)
    assert together.declared[:, 4].sum(-1).tolist()[:2] == [2, 1]
    for b in range(2):
        alone = track(record(mixed[b : b + 1]), tracker, SEEDS[b : b + 1])
        assert_same(TrackHistory(*(t[b : b + 1] for t in together)), alone, **TOLERANCE[dtype])


@either
@pytest.mark.parametrize("shape", [(), (1, 3)])
def test_other_batches(mixed, detector, shape):
    tracker, num = make_tracker(detector), math.prod(shape)
    histories = []
    for batch in (shape, (num,)):
        measurement = from_snapshots(mixed[:num, :6].reshape(*batch, 6, *mixed.shape[2:]))
        streams = RandomStreams.from_seeds(SEEDS[:num], batch, torch.float64)
        histories.append(tracker.run(measurement, data_priors(measurement), streams))
    found = TrackHistory(*(t.reshape(num, *t.shape[len(shape) :]) for t in histories[0]))
    assert_same(found, histories[1], **TOLERANCE[torch.float64])


@either
def test_steps_in_a_loop_equal_a_run(mixed, detector):
    tracker, measurement = make_tracker(detector), from_snapshots(mixed[:2, :5])
    priors = data_priors(measurement)
    reported: list[int] = []
    streams = RandomStreams.from_seeds([1, 2], (2,), torch.float64)
    expected = tracker.run(measurement, priors, streams, lambda k, *_: reported.append(k))
    streams, state, steps = RandomStreams.from_seeds([1, 2], (2,), torch.float64), tracker.init(priors), []
    for k in range(5):
        state, estimate = tracker.step(state, measurement.at(k), priors, streams)
        steps.append(estimate)
    found = TrackHistory.of_steps(steps, 1)
    torch.testing.assert_close(found, expected, rtol=0, atol=0, equal_nan=True)
    assert reported == list(range(5))
    assert found.declared.any()
    assert_sound(state, found)


@either
def test_units_change_nothing_but_the_units(mixed, tracked, detector):
    """Another unit for every sequence."""
    unit = torch.tensor([1e-12, 7.3e5, 1.0], dtype=torch.float64)
    found = track(record(unit[:, None, None, None, None] * mixed), make_tracker(detector), SEEDS)
    square = unit.square()[:, None, None]
    found = found._replace(power=found.power / square[..., None], noise=found.noise / square)
    assert_same(found, tracked[detector], **TOLERANCE[torch.float64])
    assert found.log_evidence.isnan().all()


@either
def test_covariances_say_the_same_as_their_snapshots(mixed, tracked, detector):
    covariance = validate(step_s=1.0, covariance=sample_covariance(mixed), num_snapshots=3)
    found = track(covariance, make_tracker(detector), SEEDS)
    assert_same(found, tracked[detector], rtol=1e-5, atol=1e-5)


@either
def test_steps_without_data_count_as_missed(detector):
    data = simulate(1, *TWO)[0][:13]
    data[8:11] = torch.nan
    history = track(record(data[None]), make_tracker(detector), [1])
    for name, values in history._asdict().items():
        assert name == "log_evidence" or values.double().isfinite().all(), name
    existence = history.existence[0, 7, :2]
    assert (existence > 0.9).all()
    for k in (8, 9, 10):
        survived = SURVIVAL * existence
        existence = survived * (1 - DETECTION) / (1 - survived * DETECTION)
        torch.testing.assert_close(history.existence[0, k, :2], existence)
        assert torch.equal(history.power[0, k, :2], history.power[0, 7, :2])
    assert len(labels_at(history, 7)) == 2
    assert labels_at(history, 10) == set()
    assert labels_at(history, 12) == labels_at(history, 7)


@either
@pytest.mark.parametrize("broken", ["channel", "tone", "everything"])
def test_missing_data_are_taken_in_stride(mixed, detector, broken):
    data = mixed[:1].clone()
    if broken == "channel":
        data[..., 3] = torch.nan
        data[:, 2:5, 0, :, 6] = torch.nan
    elif broken == "tone":
        data[:, 4:6, 1] = torch.nan
    else:
        data[:] = torch.nan
    history = track(record(data), make_tracker(detector), [1])
    assert history.state.isfinite().all()
    assert history.noise.isfinite().all()
    assert history.declared[0, -1].sum() == (0 if broken == "everything" else 2)


@either
def test_a_silent_object_dies_and_the_next_one_has_a_new_label(detector):
    data, _ = simulate(3, *ONE, steps=24)
    data[8:16] = simulate(5, steps=24)[0][8:16]
    history = track(record(data[None]), make_tracker(detector), [1])
    first, gap, second = (labels_at(history, k) for k in (7, 15, 23))
    assert (len(first), len(gap), len(second)) == (1, 0, 1)
    assert max(first) < min(second)


@either
def test_every_sequence_in_its_own_field(mixed, detector):
    """The same data under two speeds of sound: other bearings, each as in that field alone."""
    fields = [LineArrayField(FREQS, POSITIONS, speed, dtype=torch.float64) for speed in (1500.0, 1400.0)]
    pair = mixed[:1, :6].expand(2, -1, -1, -1, -1)
    together = track(record(pair), make_tracker(detector, field=StackedField(fields)), [1, 1])
    for b, field in enumerate(fields):
        alone = track(record(pair[:1]), make_tracker(detector, field=field), [1])
        assert_same(TrackHistory(*(t[b : b + 1] for t in together)), alone, **TOLERANCE[torch.float64])
    bearings = [sorted(together.position[b, -1][together.declared[b, -1]][:, 0].tolist()) for b in range(2)]
    assert bearings[1] == pytest.approx(bearings[0], abs=5)
    assert abs(bearings[1][0] - bearings[0][0]) > 1


@pytest.mark.parametrize("kind", ["direct", *DETECTORS])
def test_every_tracker_is_used_alike(kind):
    def last_bearings(tracker: Tracker, recording: Recording) -> list[float]:
        assert tracker.dictionary.response.shape == (2, 70, tracker.field.num_sensors)
        assert tracker.region.column_names == ("bearing_deg", "bearing_rate_degps")
        history = track(recording, tracker, [3])
        assert history.declared.shape[:2] == (1, 10)
        return sorted(history.position[0, -1][history.declared[0, -1]][:, 0].tolist())

    data, truth = simulate(3, *TWO)
    tracker = make_direct_tracker() if kind == "direct" else make_tracker(kind)
    expected = sorted(truth[9, :, 0].tolist())
    assert last_bearings(tracker, record(data[None, :10])) == pytest.approx(expected, abs=3)


@either
def test_infinite_data_count_as_missing(mixed, detector):
    data = mixed[:1, :5].clone()
    priors = data_priors(from_snapshots(data))
    data[0, 1, 0, 1, 2] = complex(0.0, -math.inf)
    streams = RandomStreams.from_seeds([1], (1,), torch.float64)
    history = make_tracker(detector).run(from_snapshots(data), priors, streams)
    assert history.failed[0].nonzero().squeeze(-1).tolist() == [1]
    assert history.position[history.declared].isfinite().all()


def test_settings_choose_the_detector():
    kinds = {"mp": MatchingPursuit, "sbl": SparseBayesianLearning}
    for name, kind in kinds.items():
        assert isinstance(make_tracker(name).detector, kind)
    assert isinstance(TwoStepConfig().detector, PursuitConfig)


@pytest.mark.parametrize("config", [DetectorConfig(), TrackerConfig()])
def test_settings_of_no_detector_are_named(config):
    tracker = make_tracker("mp")
    expected = rf"'tracker\.detector': found {type(config).__name__}, expected PursuitConfig or SblConfig"
    with pytest.raises(InputError, match=expected):
        build_detector(tracker.field, tracker.region, tracker.dictionary, config)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("detection_probability", 0.0),
        ("detection_probability", 1.0),
        ("clutter_mean", 0.0),
        ("tolerance", math.inf),
        ("iterations", 0),
        ("spread", {"bearing": 0.0}),
        ("slots", 0),
    ],
)
def test_settings_out_of_range_are_named(key, value):
    with pytest.raises(InputError, match=rf"'tracker\.{key}': found {re.escape(str(value))}, expected "):
        TwoStepConfig(**{key: value})


def test_settings_that_do_not_fit_the_region_are_named():
    usual, motion = make_tracker("mp"), ConstantVelocity([1.0, 2.0])
    with pytest.raises(
        InputError, match=r"'model.motion\.driving_variance': found .*one number for each of 1"
    ):
        TwoStepTracker(usual.field, usual.region, 1.0, usual.config, motion)


def test_spread_is_in_cells_of_its_coordinate():
    """Cells of two degrees."""
    spreads = [make_tracker("mp", spread=s).tracker.likelihood.spread for s in ({"bearing": 0.25}, {})]
    assert [s.tolist() for s in spreads] == [[0.5], [1.0]]


@either
def test_a_recording_of_another_array_is_named(mixed, detector):
    with pytest.raises(InputError, match="found 7 sensors, expected 8 sensors"):
        track(record(mixed[..., :7]), make_tracker(detector), [1, 2, 3])


@either
def test_some_sequences_share_what_all_share(detector):
    tracker = make_tracker(detector)
    part = tracker.select(slice(1, 3))
    assert part.dictionary is tracker.dictionary
    assert part.detector is tracker.detector
    fields = [LineArrayField(FREQS, POSITIONS, c, dtype=torch.float64) for c in (1500.0, 1400.0, 1600.0)]
    own = make_tracker(detector, field=StackedField(fields)).select(slice(1, 3))
    assert own.field.field.fields == tuple(fields[1:])
    assert own.dictionary.response.shape[0] == 2
    assert own.tracker.step_s == tracker.tracker.step_s
