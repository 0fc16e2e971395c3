"""Sample covariances on the line array that count as another number of snapshots than the data say."""

import pytest
import torch
from oracles.likelihood import TWO, evaluate, frozen_proposals, rewind
from oracles.line_array import make_field, make_region, make_tracker, simulate
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.data.prepare import prepare
from torchdt.data.recording import validate
from torchdt.filter.history import TrackHistory
from torchdt.model.measurement import Measurement, from_covariance
from torchdt.model.prior import data_priors
from torchdt.model.wishart import log_normaliser

F64 = torch.float64
TRUE, NOMINAL, STEPS = 40, 15.0, 6


@pytest.fixture(scope="module")
def covariance() -> Tensor:
    """Two runs, `(2, K, I, M, M)`."""
    snapshots = torch.stack([simulate(seed, *TWO, steps=STEPS, num_snapshots=TRUE)[0] for seed in (1, 2)])
    return snapshots.mT @ snapshots.conj() / TRUE


@pytest.fixture(scope="module")
def measurement(covariance) -> Measurement:
    return from_covariance(covariance, NOMINAL)


def run(measurement: Measurement, **config) -> TrackHistory:
    streams = RandomStreams.from_seeds([1, 2], (2,), F64)
    with torch.no_grad():
        return make_tracker(**config).run(measurement, data_priors(measurement), streams)


def test_estimates_are_those_of_so_many_snapshots(measurement):
    counted = measurement.recounted(torch.tensor(60.0, dtype=F64))
    found, expected = run(measurement, effective_count=60.0), run(counted)
    for name in set(TrackHistory._fields) - {"log_evidence"}:
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-12)
    constant = log_normaliser(measurement, torch.tensor(60.0, dtype=F64)).sum(-1)
    torch.testing.assert_close(found.log_evidence, expected.log_evidence + constant)
    assert (found.position - run(measurement).position).abs().max() > 1e-3


def test_each_sequence_may_have_its_own(measurement):
    tracker = make_tracker()
    counts = torch.tensor([20.0, 60.0], dtype=F64)
    both = evaluate(tracker.with_model(tracker.model.with_numbers({"effective_count": counts})), measurement)
    for index, count in enumerate(counts):
        alone = make_tracker(effective_count=count.item())
        one = Measurement(*(part[index : index + 1] for part in measurement))
        torch.testing.assert_close(both[index : index + 1], evaluate(alone, one, [index + 1]))


def test_gradient_equals_finite_differences(measurement):
    """Common random numbers, proposals held still: relative error 1e-5."""
    tracker = make_tracker(particles=40)

    def value(count: Tensor) -> Tensor:
        parameters = tracker.model.with_numbers({"effective_count": count})
        return evaluate(tracker.with_model(parameters), measurement).sum()

    count = torch.tensor(30.0, dtype=F64, requires_grad=True)
    with frozen_proposals() as tapes:
        (found,) = torch.autograd.grad(value(count), count)
        with torch.no_grad():
            rewind(tapes)
            above = value(count + 1e-3)
            rewind(tapes)
            below = value(count - 1e-3)
    assert found.abs() > 0.1
    torch.testing.assert_close(found, (above - below) / 2e-3, rtol=1e-5, atol=1e-6)


def test_the_true_number_is_the_likeliest(measurement):
    """Known to sqrt(2 / (K I M^2)) = 3.6 % per run where the sources are known: 25 % is 10 errors of both."""
    values = {
        count: run(measurement, effective_count=count).log_evidence.sum().item()
        for count in (30.0, TRUE, 50.0)
    }
    assert max(values, key=values.get) == TRUE


def test_snapshots_have_a_known_number(covariance):
    recording = validate(snapshots=torch.randn(3, 2, 4, 8, dtype=torch.complex128), step_s=1.0)
    with pytest.raises(InputError, match=r"'model.effective_count': found 20.0, expected null"):
        prepare(recording, make_field(), make_region(), effective_count=20.0)
