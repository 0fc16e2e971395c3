"""A step that breaks down counts as missing for its sequence, and changes nothing for the others."""

import logging
import math

import pytest
import torch
from oracles.line_array import make_tracker, simulate

from torchdt.core.linalg import NumericalError
from torchdt.core.random import RandomStreams
from torchdt.filter.direct import DirectTracker
from torchdt.filter.likelihood import log_likelihood
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.prior import data_priors

ONE = (((0.0, 5.0), (12.0, 12.0)),)
STEPS, STEP, BAD = 5, 3, 1


class Picky(DirectTracker):
    """Breaks down where any sequence of a batch holds infinite data; `always`, without data too."""

    always = False

    def step(self, state, measurement, priors, streams):
        streams.uniform(3)  # what is drawn before the breakdown must be drawn again
        if self.always or measurement.factor.isinf().any():
            raise NumericalError("covariance: not positive definite")
        return super().step(state, measurement, priors, streams)


@pytest.fixture(scope="module")
def tracker() -> Picky:
    plain = make_tracker()
    return Picky(plain.field, plain.region, 1.0, plain.config)


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return from_snapshots(torch.stack([simulate(seed, *ONE, steps=STEPS)[0] for seed in range(3)]))


def streams(*seeds: int) -> RandomStreams:
    return RandomStreams.from_seeds(seeds, (len(seeds),), torch.float64)


def broken(measurement: Measurement, bad: int = BAD) -> Measurement:
    factor = measurement.factor.clone()
    factor[bad, STEP, 0, 2, 0] = math.inf
    return measurement._replace(factor=factor)


def missing(measurement: Measurement) -> Measurement:
    """The same step without data."""
    changed = Measurement(*(part.clone() for part in measurement))
    for part in changed:
        part[BAD, STEP] = 0
    return changed


@torch.inference_mode()
def test_a_breakdown_is_missing_data_for_its_sequence_alone(tracker, measurement, caplog):
    priors = data_priors(measurement)
    with caplog.at_level(logging.WARNING, "torchdt"):
        found = tracker.run(broken(measurement), priors, streams(4, 5, 6), first=20)
    (record,) = caplog.records
    place, reason = f"sequence {20 + BAD}, step {STEP}", "covariance: not positive definite"
    assert record.getMessage() == f"{place} broke down and counts as missing: {reason}"
    assert found.failed.nonzero().tolist() == [[BAD, STEP]]
    expected = tracker.run(missing(measurement), priors, streams(4, 5, 6))
    assert expected.declared[:, -1].any()
    for name, part, other in zip(found._fields, found, expected, strict=True):
        if name != "failed":
            torch.testing.assert_close(part, other, rtol=1e-9, atol=1e-9, msg=name)


@torch.inference_mode()
def test_a_stream_without_a_batch_goes_on(tracker, measurement):
    one = Measurement(*(part[BAD] for part in broken(measurement)))
    priors = data_priors(Measurement(*(part[BAD] for part in measurement)))
    alone = RandomStreams.from_seeds([4], (), torch.float64)
    steps = list(tracker.stream((one.at(k) for k in range(STEPS)), priors, alone))
    assert [bool(step.failed) for step in steps] == [k == STEP for k in range(STEPS)]
    assert steps[STEP].log_evidence == 0


def test_a_breakdown_without_data_is_an_error(tracker, measurement, monkeypatch):
    monkeypatch.setattr(Picky, "always", True)
    with pytest.raises(NumericalError, match=r"^sequence 7, step 0, even without data: covariance: not pos"):
        tracker.run(measurement, data_priors(measurement), streams(1, 2, 3), first=7)


def test_a_likelihood_goes_on_with_nothing(tracker, measurement):
    """Without these data it would be another function of the parameters."""
    with pytest.raises(NumericalError, match=f"^step {STEP}: covariance: not positive definite$"):
        log_likelihood(tracker, broken(measurement), data_priors(measurement), streams(1, 2, 3))
