"""Tracking of points: batches, missing points, thresholds, labels, random numbers."""

import math

import pytest
import torch
from oracles.point_tracking import (
    F64,
    NOTHING,
    PATHS,
    SCENE,
    STEPS,
    assert_sound,
    make_tracker,
    run,
    scene,
    with_one_object,
)
from oracles.points import (
    batch_of_one,
    make_points,
    no_points,
    simulate,
    stacked,
    true_positions,
)

from torchdt.baselines.detect.points import Points
from torchdt.core.linalg import NumericalError
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import Systematic
from torchdt.filter.history import StepEstimate, TrackHistory


def assert_same(found: TrackHistory, expected: TrackHistory, **tolerance) -> None:
    for name in ("existence", "declared", "noise"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), **tolerance)
    alive = expected.existence > 0
    for name in ("label", "state", "state_std", "power"):
        torch.testing.assert_close(getattr(found, name)[alive], getattr(expected, name)[alive], **tolerance)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_a_batch_equals_single_runs(dtype):
    """Sequences of four objects, of none, and without any points."""
    four = [simulate(s, true_positions(STEPS, PATHS), **SCENE, dtype=dtype) for s in (1, 2)]
    points = stacked([*four, simulate(3, NOTHING, **SCENE, dtype=dtype), no_points(STEPS, dtype)])
    tracker, seeds = make_tracker(dtype, particles=200), [5, 6, 7, 8]
    _, together = run(tracker, points, seeds)
    assert together.declared[:, -1].sum(-1).tolist() == [2, 2, 0, 0]
    tolerance = {"rtol": 1e-6, "atol": 1e-6} if dtype == F64 else {"rtol": 1e-2, "atol": 1e-2}
    for b, seed in enumerate(seeds):
        _, alone = run(tracker, Points(*(t[b : b + 1] for t in points)), [seed])
        assert_same(TrackHistory(*(t[b : b + 1] for t in together)), alone, **tolerance)


def test_any_batch_shape():
    points, tracker = scene([1, 2, 3, 4]), make_tracker(particles=100)
    _, flat = run(tracker, points, [1, 2, 3, 4])
    for shape, part in (((2, 2), slice(None)), ((), 0)):
        seeds = [1, 2, 3, 4] if shape else [1]
        streams = RandomStreams.from_seeds(seeds, shape, F64)
        state, steps = tracker.init(shape, 1), []
        for k in range(10):
            now = Points(*(t[part, k].reshape(*shape, *t.shape[2:]) for t in points))
            state, estimate = tracker.step(state, now, streams)
            steps.append(StepEstimate(*(t.reshape(len(seeds), *t.shape[len(shape) :]) for t in estimate)))
        found = TrackHistory.of_steps(steps, 1)
        expected = TrackHistory(*(t[: len(seeds), :10] for t in flat))
        assert expected.declared.any()
        assert_same(found, expected, rtol=1e-6, atol=1e-6)


def test_absent_points_may_hold_anything_finite():
    points, tracker = scene([1]), make_tracker()
    position = torch.where(points.present[..., None], points.position, 1e6)
    power = torch.where(points.present[..., None], points.power, 1e6)
    _, found = run(tracker, points._replace(position=position, power=power), [1])
    _, expected = run(tracker, points, [1])
    assert expected.declared.any()
    for a, b in zip(found[:-1], expected[:-1], strict=True):
        assert torch.equal(a, b)


def test_absent_points_may_be_anywhere():
    """What a known object makes of the points does not depend on their places."""
    tracker, mean = make_tracker(), torch.tensor([500.0, 150.0, 3.0, -2.0], dtype=F64)
    state = with_one_object(tracker, mean, torch.full((4,), 5.0, dtype=F64), 1.0, [1])
    where = torch.tensor([[510.0, 140.0], [490.0, 165.0], [100.0, 0.0]], dtype=F64)
    points = batch_of_one(make_points([where], [torch.tensor([1.0, 2.0, 3.0])], F64))
    moved = points._replace(
        position=points.position.flip(2), power=points.power.flip(2), present=points.present.flip(2)
    )
    assert not moved.present[0, 0, 0]
    (_, found), (_, expected) = run(tracker, moved, [1], state), run(tracker, points, [1], state)
    for name in ("existence", "state", "power"):
        torch.testing.assert_close(getattr(found, name)[0, 0, 0], getattr(expected, name)[0, 0, 0])
    assert expected.existence[0, 0, 0] > 0.9


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_without_points_objects_fade(dtype):
    """Each step is a missed detection: r' = p_s r (1 - p_D) / (1 - p_s r p_D)."""
    tracker, seeds = make_tracker(dtype, prune=1e-3), [1]
    mean = torch.tensor([500.0, 150.0, 0.0, 0.0], dtype=dtype)
    start = with_one_object(tracker, mean, torch.ones(4, dtype=dtype), math.log(99), seeds)
    state, history = run(tracker, batch_of_one(no_points(6, dtype)), seeds, start)
    assert_sound(state, history)
    r, expected = 0.99, []
    for _ in range(6):
        r = 0.1 * 0.99 * r / (1 - 0.9 * 0.99 * r)
        r = r if r >= 1e-3 else 0.0
        expected.append(r)
    assert expected[-1] == 0 < expected[2]
    torch.testing.assert_close(history.existence[0, :, 0], torch.tensor(expected, dtype=dtype))
    assert history.label[0, :, 0].tolist() == [int(r > 0) for r in expected]
    assert history.existence[0, :, 1:].eq(0).all()


def test_an_object_that_leaves_the_region_ends():
    """Half of its belief is outside after the first step, all of it after the second."""
    tracker, seeds = make_tracker(particles=20_000, detection_probability=1e-9, survival=1 - 1e-9), [1]
    mean = torch.tensor([996.0, 150.0, 4.0, 0.0], dtype=F64)
    start = with_one_object(tracker, mean, torch.full((4,), 0.1, dtype=F64), 30.0, seeds)
    _, history = run(tracker, batch_of_one(no_points(2)), seeds, start)
    assert abs(history.existence[0, 0, 0] - 0.5) < 5 * 0.5 / 20_000**0.5  # false alarm 6e-7
    assert history.state[0, 0, 0, 0] < 1000
    assert history.existence[0, 1].eq(0).all()


def one_object(steps: int, power: float = 3.0) -> Points:
    """An object at rest, seen exactly in every step."""
    where = torch.tensor([[400.0, 100.0]], dtype=F64)
    return batch_of_one(make_points([where] * steps, [torch.tensor([power])] * steps, F64))


def test_labels_are_given_when_an_object_is_first_declared():
    """The threshold decides when; the label stays while existence is below it again."""
    first = {}
    for declare in (0.1, 0.5, 0.95):
        seen, gap = one_object(6), batch_of_one(no_points(2))
        points = Points(*(torch.cat([a, b, a], 1) for a, b in zip(seen, gap, strict=True)))
        state, history = run(make_tracker(declare=declare), points, [1])
        assert torch.equal(history.declared, history.existence > declare)
        first[declare] = int(history.declared[0].any(-1).nonzero()[0])
        assert history.label[0, : first[declare]].eq(0).all()
        assert history.label[0, first[declare] :, 0].eq(1).all()
        assert state.next_label.tolist() == [2]
    assert not history.declared[0, 7].any()
    assert history.declared[0, -1].sum() == 1
    assert first[0.1] < first[0.95]


def test_improbable_objects_are_pruned():
    """A new object starts with odds of mu_B / mu_c here: a threshold above that lets none live."""
    for prune, alive in ((0.0049, 1), (0.0051, 0)):
        state, history = run(make_tracker(prune=prune), one_object(1), [1])
        assert int(state.objects.log_odds.isfinite().sum()) == alive
    assert history.existence.eq(0).all()


def test_the_most_probable_objects_are_kept():
    """Five points for two slots, those beside the tracked object being new."""
    where = torch.tensor(
        [[400.0, 100.0], [100.0, 0.0], [700.0, 50.0], [800.0, 300.0], [200.0, 250.0]], dtype=F64
    )
    positions = [where[:1]] * 5 + [where]
    points = batch_of_one(make_points(positions, [torch.ones(len(p)) for p in positions], F64))
    state, history = run(make_tracker(slots=2), points, [1])
    assert_sound(state, history)
    assert history.existence[0, -1, 0] > 0.9
    assert 0 < history.existence[0, -1, 1] < 0.1
    assert history.label[0, -1].tolist() == [1, 0]


def test_power_is_that_of_the_points_and_stays_without_them():
    seen, gap = one_object(6), batch_of_one(no_points(1))
    points = Points(*(torch.cat([a, b], 1) for a, b in zip(seen, gap, strict=True)))
    _, history = run(make_tracker(), points, [1])
    torch.testing.assert_close(history.power[0, :, 0], torch.full((7, 1), 3.0, dtype=F64))
    louder = Points(*(torch.cat([a, b], 1) for a, b in zip(seen, one_object(1, 8.0), strict=True)))
    power = run(make_tracker(), louder, [1])[1].power[0, -1, 0]
    assert 7.9 < power < 8
    assert torch.equal(history.noise, points.noise)


def test_only_poor_sets_are_resampled():
    """Without, the effective sample size goes down with every point; with, it comes up again."""
    sizes = {}
    for below in (0.0, 0.5):
        tracker = make_tracker(resampler=Systematic(below=below), particles=1000)
        state, history = run(tracker, one_object(12), [1])
        sizes[below] = history.effective_sample_size[0, :, 0]
        even = state.objects.log_weight[0, 0].unique().numel() == 1
        assert even == bool(sizes[below][-1] < below * 1000)
    assert sizes[0.0][-1] < 100
    assert sizes[0.5].min() > 100


def test_the_same_seed_gives_the_same_numbers_and_as_many_of_them():
    tracker, ends = make_tracker(particles=50), []
    for points in (scene([1]), batch_of_one(no_points(STEPS)), scene([1])):
        streams = RandomStreams.from_seeds([3], (1,), F64)
        state = tracker.init((1,), 1)
        for k in range(8):
            state, estimate = tracker.step(state, Points(*(t[:, k] for t in points)), streams)
        ends.append((estimate.state, streams.normal(3)))
    assert torch.equal(ends[0][0], ends[2][0])
    assert not torch.equal(ends[0][0], ends[1][0])
    assert torch.equal(ends[0][1], ends[1][1])


def test_a_point_that_is_no_number_is_an_error():
    points = one_object(2)
    position = points.position.clone()
    position[0, 1, 0, 1] = torch.nan
    with pytest.raises(NumericalError, match="likelihood of a point"):
        run(make_tracker(), points._replace(position=position), [1])
