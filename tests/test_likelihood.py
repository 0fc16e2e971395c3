"""The marginal likelihood of sequences and its gradient, on a line array."""

import contextlib
from collections.abc import Iterator
from unittest import mock

import pytest
import torch
from oracles.line_array import make_tracker, simulate
from torch import Tensor

import torchdt.placement
import torchdt.proposal.moved
import torchdt.proposal.newborn
import torchdt.tracker
from torchdt.likelihood import log_likelihood
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.parameters import Parameters
from torchdt.model.prior import data_priors
from torchdt.random import RandomStreams
from torchdt.tracker import DirectTracker

F64 = torch.float64
TWO = (((0.0, -40.0), (12.0, -25.0)), ((0.0, 30.0), (12.0, 20.0)))
ONE = (((0.0, 5.0), (12.0, 12.0)),)
# Away from the defaults, so that every number matters: powers and noise may move, the likelihood is tempered.
START = {
    "power_shape": 50.0,
    "noise_shape": 20.0,
    "survival": 0.9,
    "birth_mean": 0.1,
    "driving_variance": [2e-3],
    "likelihood_power": 0.7,
}


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return from_snapshots(torch.stack([simulate(1, *TWO, steps=8)[0], simulate(2, *ONE, steps=8)[0]]))


def parameters(**changed: Tensor) -> Parameters:
    values = {name: torch.tensor(value, dtype=F64) for name, value in START.items()}
    return Parameters(**(values | changed))


def evaluate(tracker: DirectTracker, measurement: Measurement, seeds=(1, 2), **options) -> Tensor:
    streams = RandomStreams.from_seeds(seeds, (len(seeds),), tracker.region.low.dtype)
    return log_likelihood(tracker, measurement, data_priors(measurement), streams, **options)


def gradients(tracker: DirectTracker, measurement: Measurement, **options) -> dict[str, Tensor]:
    leaves = {name: value.requires_grad_() for name, value in parameters()._asdict().items()}
    total = evaluate(tracker.with_parameters(Parameters(**leaves)), measurement, **options).sum()
    return dict(zip(leaves, torch.autograd.grad(total, leaves.values()), strict=True))


class Tape:
    """Records what a function returns, then plays it back; calls from inside another tape are not its own."""

    running = False

    def __init__(self, function):
        self.function, self.record, self.position = function, [], None

    def __call__(self, *arguments, **options):
        if Tape.running:
            return self.function(*arguments, **options)
        if self.position is None:
            Tape.running = True
            self.record.append(self.function(*arguments, **options))
            Tape.running = False
            return self.record[-1]
        self.position += 1
        return self.record[self.position - 1]


@contextlib.contextmanager
def frozen_proposals() -> Iterator[list[Tape]]:
    """What is constant to the gradient: particles, picks and drawn configurations."""
    with contextlib.ExitStack() as stack:
        tapes = []
        for module, name in (
            (torchdt.proposal.moved, "draw_adapted"),
            (torchdt.proposal.newborn, "adapt"),
            (torchdt.placement, "search"),
            (torchdt.tracker, "draw_configurations"),
        ):
            tapes.append(Tape(getattr(module, name)))
            stack.enter_context(mock.patch.object(module, name, tapes[-1]))
        yield tapes


@pytest.mark.parametrize("proposal", ["adapted", "prior"])
@pytest.mark.parametrize("evidence", ["sampled", "gaussian"])
def test_gradient_equals_finite_differences(measurement, proposal, evidence):
    """Common random numbers, nothing resampled, particles that move: relative error 1e-5."""
    tracker = make_tracker(
        proposal=proposal, evidence=evidence, gradient="reparameterised", particles=60, resample_below=0.0
    )
    with frozen_proposals() as tapes:
        found = gradients(tracker, measurement)
        assert tapes[2].record

        def value(**changed: Tensor) -> float:
            for tape in tapes:
                tape.position = 0
            return evaluate(tracker.with_parameters(parameters(**changed)), measurement).sum().item()

        for name, start in parameters()._asdict().items():
            step = 1e-5 * start
            slope = (value(**{name: start + step}) - value(**{name: start - step})) / (2 * step.item())
            assert found[name].sum().item() == pytest.approx(slope, rel=1e-5, abs=1e-6), name
