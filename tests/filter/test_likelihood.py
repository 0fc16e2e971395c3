"""The marginal likelihood of sequences on a line array: its value, blocks, cuts, batches and gaps."""

from unittest import mock

import pytest
import torch
from oracles.likelihood import STEPS, differentiate, evaluate, measurements, model, snapshots
from oracles.line_array import make_tracker
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.filter.direct import DirectTracker
from torchdt.filter.likelihood import log_likelihood
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.filter.state import TrackerState
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.model import stack_models
from torchdt.model.motion.driving import Reparameterised, Score
from torchdt.model.prior import data_priors

pytestmark = pytest.mark.slow
F64 = torch.float64
MODES = pytest.mark.parametrize("gradient", [Score(), Reparameterised()])


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return measurements()


def small(dtype: torch.dtype = F64, **config) -> DirectTracker:
    few = {"particles": 50, "proposal": Adapted(rounds=4, round_size=32)}
    tracker = make_tracker(dtype, **(few | config))
    return tracker.with_model(model(dtype))


def assert_same(found: tuple, expected: tuple, rel: float = 1e-9) -> None:
    """Equal evidences and gradients."""
    torch.testing.assert_close(found[0], expected[0], rtol=rel, atol=rel)
    for name, slope in expected[1].items():
        torch.testing.assert_close(found[1][name], slope, rtol=rel, atol=rel * slope.abs().max().item())


def test_value_and_streams_are_those_of_a_run(measurement):
    tracker, priors = small(), data_priors(measurement)
    streams = [RandomStreams.from_seeds([1, 2], (2,), F64) for _ in range(2)]
    with torch.no_grad():
        expected = tracker.run(measurement, priors, streams[0]).log_evidence
        found = log_likelihood(tracker, measurement, priors, streams[1])
    assert found.shape == (2, STEPS)
    assert torch.equal(found, expected)
    assert torch.equal(streams[1].normal(5), streams[0].normal(5))
    assert (found.abs() > 1).all()


@pytest.fixture(scope="module")
def whole(measurement) -> tuple[Tensor, dict[str, Tensor]]:
    """Value and gradient with nothing blocked or cut."""
    return differentiate(small(), measurement)


@pytest.mark.parametrize("block", [1, 4, 100])
def test_blocks_change_nothing(measurement, whole, block):
    assert_same(differentiate(small(), measurement, block=block), whole)


def test_blocks_that_run_again_leave_the_streams_alone(measurement):
    priors = data_priors(measurement)
    streams = [RandomStreams.from_seeds([1, 2], (2,), F64) for _ in range(2)]
    with torch.no_grad():
        small().run(measurement, priors, streams[0])
    survival = torch.tensor(0.9, dtype=F64, requires_grad=True)
    tracker = small().with_model(model(survival=survival))
    value = log_likelihood(tracker, measurement, priors, streams[1], block=2)
    before = streams[1].snapshot()
    value.sum().backward()
    assert all(torch.equal(a, b) for a, b in zip(streams[1].snapshot(), before, strict=True))
    assert torch.equal(streams[1].normal(5), streams[0].normal(5))


@pytest.mark.parametrize(("block", "with_gradient", "runs"), [(3, True, 2), (3, False, 1), (None, True, 1)])
def test_steps_run_again_only_for_the_gradient_of_blocks(measurement, block, with_gradient, runs):
    tracker = small()
    with mock.patch.object(DirectTracker, "step", autospec=True, side_effect=DirectTracker.step) as step:
        if with_gradient:
            differentiate(tracker, measurement, block=block)
        else:
            with torch.no_grad():
                evaluate(tracker, measurement, block=block)
    assert step.call_count == runs * STEPS


def cut(state: TrackerState) -> TrackerState:
    objects, noise = (type(part)(*(t.detach() for t in part)) for part in state[:2])
    return TrackerState(objects, noise, state.next_label, state.undetected.detach(), state.interference)


@MODES
def test_truncation_after_every_step_is_the_sum_of_one_step_gradients(measurement, gradient):
    tracker, priors = small(gradient=gradient), data_priors(measurement)
    leaves = {name: value.requires_grad_() for name, value in model().known().items()}
    tracker = tracker.with_model(model().with_numbers(leaves))
    streams = RandomStreams.from_seeds([1, 2], (2,), F64)
    state, values = tracker.init(priors), []
    expected = {name: torch.zeros_like(value) for name, value in leaves.items()}
    for k in range(STEPS):
        state, estimate = tracker.step(state if k == 0 else cut(state), measurement.at(k), priors, streams)
        values.append(estimate.log_evidence.detach())
        total = estimate.log_evidence.sum()
        for name, leaf in leaves.items():
            (slope,) = torch.autograd.grad(total, leaf, retain_graph=True, materialize_grads=True)
            expected[name] = expected[name] + slope
    assert_same(differentiate(tracker, measurement, truncate=1), (torch.stack(values, -1), expected))


def test_cuts_lose_what_a_step_owes_to_earlier_ones(measurement, whole):
    """The value stays. Of the noise's moves, cuts after every step leave that before the first one alone."""
    value, slopes = differentiate(small(), measurement, truncate=1)
    torch.testing.assert_close(value, whole[0])
    first = Measurement(*(part[:, :1] for part in measurement))
    streams = RandomStreams.from_seeds([1, 2], (2,), F64)
    shape = model().noise.noise_shape.requires_grad_()
    tracker = small().with_model(model(noise_shape=shape))
    alone = log_likelihood(tracker, first, data_priors(measurement), streams).sum()
    assert slopes["noise_shape"] != 0
    torch.testing.assert_close(slopes["noise_shape"], torch.autograd.grad(alone, shape)[0])
    for name in ("power_shape", "noise_shape", "driving_variance", "likelihood_power"):
        assert (slopes[name] - whole[1][name]).abs() > 0.01 * whole[1][name].abs()


def test_a_segment_as_long_as_the_sequence_cuts_nothing(measurement, whole):
    assert_same(differentiate(small(), measurement, truncate=STEPS), whole)


def test_blocks_end_at_cuts(measurement, whole):
    """Blocks of 2 in segments of 3 are of 2, 1, 2 and 1 steps."""
    expected = differentiate(small(), measurement, truncate=3)
    assert_same(differentiate(small(), measurement, truncate=3, block=2), expected)
    assert expected[1]["noise_shape"] != 0
    assert (expected[1]["noise_shape"] - whole[1]["noise_shape"]).abs() > 0.01 * whole[1]["noise_shape"].abs()


@pytest.mark.parametrize("value", [0, -1])
@pytest.mark.parametrize("name", ["block", "truncate"])
def test_bad_options_are_named(measurement, name, value):
    with pytest.raises(InputError, match=f"'{name}': found {value}, expected a positive integer or None"):
        evaluate(small(), measurement, **{name: value})


@MODES
def test_a_batch_of_parameters_equals_separate_runs(measurement, gradient):
    """Each sequence with a setting of its own, of every parameter."""
    tracker = small(gradient=gradient)
    first, second = model(), model()
    second = second.with_numbers({name: 0.8 * value for name, value in second.known().items()})
    both = stack_models([first, second], 1)
    together, slopes = differentiate(tracker, measurement, both)
    for b, own in enumerate((first, second)):
        alone = Measurement(*(t[b : b + 1] for t in measurement))
        found = together[b : b + 1], {name: slope[b] for name, slope in slopes.items()}
        assert_same(found, differentiate(tracker, alone, own, seeds=[b + 1]), rel=1e-6)
    assert not torch.equal(slopes["survival"][0], slopes["survival"][1])


def assert_finite(slopes: dict[str, Tensor]) -> None:
    for name, slope in slopes.items():
        assert slope.isfinite().all(), name


@MODES
def test_steps_without_data_add_nothing(gradient):
    """The first step, one in the middle, and a tone of another are missing."""
    data = snapshots()
    data[:, [0, 3]] = torch.nan
    data[:, 4, 1] = torch.nan
    value, slopes = differentiate(small(gradient=gradient), from_snapshots(data))
    silent = torch.zeros(STEPS, dtype=torch.bool)
    silent[[0, 3]] = True
    assert value[:, silent].eq(0).all()
    assert value[:, ~silent].abs().min() > 1
    assert_finite(slopes)
    assert slopes["driving_variance"] != 0


@MODES
def test_sequences_without_data_have_no_likelihood(gradient):
    value, slopes = differentiate(
        small(gradient=gradient), from_snapshots(torch.full_like(snapshots(), torch.nan))
    )
    assert value.eq(0).all()
    assert all(slope.eq(0).all() for slope in slopes.values())


@pytest.mark.parametrize("block", [None, 2])
def test_a_padded_tail_changes_nothing(block):
    """A sequence of five steps in a batch with one of eight; where it ends its share of the gradient ends."""
    data = snapshots()
    data[0, 5:] = torch.nan
    measurement, tracker = from_snapshots(data), small()
    both = stack_models([model()], 2)
    value, slopes = differentiate(tracker, measurement, both, block=block)
    assert value[0, 5:].eq(0).all()
    short = differentiate(tracker, from_snapshots(data[:1, :5]), seeds=[1], block=block)
    assert_same((value[:1, :5], {name: slope[0] for name, slope in slopes.items()}), short, rel=1e-6)


@pytest.mark.parametrize(
    ("gradient", "proposal"),
    [(Score(), AsPredicted()), (Reparameterised(), Adapted(rounds=4, round_size=32))],
)
def test_single_precision(gradient, proposal):
    measurement = from_snapshots(snapshots().to(torch.complex64))
    tracker = small(torch.float32, gradient=gradient, proposal=proposal)
    value, slopes = differentiate(tracker, measurement, block=3)
    assert value.dtype == torch.float32
    assert {slope.dtype for slope in slopes.values()} == {torch.float32}
    assert value.isfinite().all()
    assert_finite(slopes)
    assert all(slope.ne(0).all() for slope in slopes.values())
