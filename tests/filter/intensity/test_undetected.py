"""Births that rest on many steps, in whole trackers."""

import logging

import pytest
import torch
from oracles.line_array import make_tracker, simulate

from torchdt.core.random import RandomStreams
from torchdt.core.trees import tree_map
from torchdt.field.mismatch import MismatchedField
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.context import StepContext
from torchdt.filter.intensity.settings import UNKNOWN, Ignored, Intensity
from torchdt.filter.intensity.undetected import doubted
from torchdt.filter.likelihood import log_likelihood
from torchdt.filter.proposal.cells import Unexplained, cell_statistics
from torchdt.model.measurement import from_snapshots
from torchdt.model.prior import Priors, data_priors

FAINT = ((0.0, -20.0), (40.0, -8.0))
DB = -7.5
"""Per element, tone and snapshot: some four nats a step."""


def measured(*seeds: int, steps: int = 25, level: float = DB):
    """Data of a faint source, or of noise alone where its level is minus infinity."""
    noise = level == -torch.inf
    data = [simulate(s, FAINT, steps=steps, snr_db=-200.0 if noise else level)[0] for s in seeds]
    return from_snapshots(torch.stack(data))


def run(tracker, measurement, *seeds: int):
    streams = RandomStreams.from_seeds(seeds, (len(seeds),), tracker.region.low.dtype)
    with torch.no_grad():
        return tracker.run(measurement, data_priors(measurement), streams)


def test_a_faint_source_is_found_by_many_steps_and_not_by_one():
    data = measured(1, 2, 3)
    history = run(make_tracker(), data, 1, 2, 3)
    assert history.declared[:, -5:].any(-1).all()
    there = history.declared[:, -1]
    truth = -20.0 + 12.0 * 24 / 40
    assert ((history.position[:, -1, :, 0] - truth).abs()[there] < 5).all()
    alone = run(make_tracker(undetected=Ignored()), data, 1, 2, 3)
    assert not alone.declared.any()


def test_noise_alone_is_nothing():
    data = measured(4, 5, steps=60, level=-torch.inf)
    assert not run(make_tracker(), data, 4, 5).declared.any()


def test_a_sequence_is_in_a_batch_what_it_is_alone():
    data = measured(1, 2)
    both = run(make_tracker(), data, 1, 2)
    for row, seed in enumerate((1, 2)):
        alone = run(make_tracker(), tree_map(lambda t, row=row: t[row : row + 1], data), seed)
        torch.testing.assert_close(both.existence[row], alone.existence[0], rtol=1e-6, atol=1e-9)
        torch.testing.assert_close(both.log_evidence[row], alone.log_evidence[0], rtol=1e-9, atol=1e-9)


def test_the_state_holds_all_there_is_to_go_on_from():
    """A run that is cut in the middle and goes on from the state gives the same."""
    tracker, data = make_tracker(), measured(1)
    priors, streams = data_priors(data), RandomStreams.from_seeds([1], (1,), torch.float64)
    state = tracker.init(priors)
    for k in range(5):
        state, _ = tracker.step(state, data.at(k), priors, streams)
    assert state.undetected is not None
    assert state.undetected.sum() > 0
    place, copied = streams.snapshot(), tree_map(torch.clone, state)
    _, first = tracker.step(state, data.at(5), priors, streams)
    streams.skip_to(place)
    _, again = make_tracker().step(copied, data.at(5), priors, streams)
    assert torch.equal(first.log_evidence, again.log_evidence)


def test_steps_without_data_move_the_intensity_and_say_nothing():
    tracker, data = make_tracker(), measured(1, steps=4)
    silent = tree_map(torch.clone, data)
    silent = silent._replace(num_snapshots=silent.num_snapshots * 0, factor=silent.factor * 0)
    silent = silent._replace(present=silent.present * 0)
    priors, streams = data_priors(data), RandomStreams.from_seeds([1], (1,), torch.float64)
    state = tracker.init(priors)
    birth, survival = 1e-4, 0.95
    for k in range(4):
        state, estimate = tracker.step(state, silent.at(k), priors, streams)
        assert estimate.log_evidence.eq(0).all()
    expected = birth * sum(survival**k for k in range(4))
    assert state.undetected.sum() == pytest.approx(expected, rel=0.01)  # what left the region is lost


def test_a_region_that_is_too_large_is_said_and_done_without(caplog):
    tracker = make_tracker(undetected=Intensity(hypotheses=300))
    with caplog.at_level(logging.WARNING):
        assert tracker.undetected is None
    assert "70 cells at 5 levels" in caplog.text
    assert "tracker.undetected.hypotheses=300" in caplog.text
    limit = Priors(torch.ones(1, 2, dtype=torch.float64), torch.ones(1, 2, dtype=torch.float64))
    assert tracker.init(limit).undetected.numel() == 0


def test_a_gradient_after_tracking_in_inference_mode():
    data = measured(1, steps=3)
    tracker, priors = make_tracker(), data_priors(data)
    streams = RandomStreams.from_seeds([1], (1,), torch.float64)
    with torch.inference_mode():
        tracker.run(data, priors, streams)
    mean = torch.tensor(1e-3, dtype=torch.float64, requires_grad=True)
    with_mean = tracker.with_model(tracker.model.with_numbers({"birth_mean": mean}))
    log_likelihood(with_mean, data, priors, streams).sum().backward()
    assert mean.grad is not None
    assert mean.grad.isfinite()
    assert mean.grad != 0


def test_what_known_objects_leave_counts_as_noise_in_all_directions_but_theirs():
    """Exactly so for responses that are orthogonal to theirs."""
    tracker, data = make_tracker(), measured(1, steps=1).at(0)
    eye, share, received = torch.eye(8, dtype=torch.complex128), 0.1, torch.tensor([[5.0, 2.0]]).double()
    noise = torch.tensor([[0.3, 0.7]], dtype=torch.float64)
    known = torch.zeros(1, 2, 8, 8, dtype=torch.complex128)
    known[..., 0, 0] = received
    dictionary = tracker.dictionary._replace(
        response=eye.expand(2, -1, -1), energy=torch.ones(2, 8, dtype=torch.float64)
    )
    left = cell_statistics(dictionary, whiten(data, known + noise[..., None, None] * eye))
    context = StepContext(tracker.field, tracker.region, tracker.model, tracker.model.noise, data)
    found = doubted(context, Unexplained(left, noise, received), share)
    louder = noise + share * received / 8
    expected = cell_statistics(dictionary, whiten(data, known + louder[..., None, None] * eye))
    torch.testing.assert_close(found.noise, louder)
    torch.testing.assert_close(found.cells.s[..., 1:], expected.s[..., 1:])
    torch.testing.assert_close(found.cells.q[..., 1:], expected.q[..., 1:])


def test_an_echo_of_a_strong_source_is_no_object():
    """26 dB below, too weak for a single step; where the field is known exactly it is a source."""
    echo = ((0.0, 30.0), (40.0, 30.0))
    data = simulate(1, FAINT, echo, steps=20, snr_db=20.0, powers_db=(0.0, -26.0))[0]
    measurement = from_snapshots(data[None])
    assert run(make_tracker(), measurement, 1).declared.sum(-1).max() == 1
    exact = make_tracker(undetected=Intensity(leftover=0.0))
    assert run(exact, measurement, 1).declared.sum(-1).max() == 2


def test_an_object_that_is_dropped_leaves_its_odds():
    """Without data existence falls by p_s a step; below the threshold the odds are those of the intensity."""
    data, prune, survival = simulate(1, FAINT, steps=3, snr_db=10.0)[0], 0.15, 0.7
    silent = torch.cat([data, torch.full_like(data[:1], torch.nan).expand(8, -1, -1, -1)])
    # Weights of many particles add up to what they should, within a third of a percent.
    tracker = make_tracker(prune=prune, survival=survival, particles=5000)
    measurement = from_snapshots(silent[None])
    priors, streams = data_priors(measurement), RandomStreams.from_seeds([1], (1,), torch.float64)
    state, existence = tracker.init(priors), 1.0
    for k in range(11):
        before, existence = state.undetected.sum(), float(state.objects.existence.max())
        state, estimate = tracker.step(state, measurement.at(k), priors, streams)
        if estimate.existence.max() == 0:
            break
    left = survival * existence
    assert left < prune < existence
    gained = state.undetected.sum() - survival * before
    assert gained == pytest.approx(left / (1 - left) + 1e-4, rel=0.01)


def test_what_is_unexplained_is_asked_of_the_field():
    """A share of mismatch says it; that a field would know how it scatters does not."""
    state = torch.tensor([[5.0]], dtype=torch.float64)
    plane = make_tracker().field
    shared = MismatchedField(plane, torch.tensor([0.1, 0.1], dtype=torch.float64))
    asked = Intensity(leftover=None)
    assert asked.unexplained(plane, state) == UNKNOWN
    assert asked.unexplained(shared, state) == 0
    assert Intensity(leftover=0.3).unexplained(shared, state) == 0.3
