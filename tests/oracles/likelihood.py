"""Likelihoods of two sequences on the line array, and what to hold still when their gradients are checked."""

import contextlib
from collections.abc import Iterator, Sequence
from unittest import mock

import torch
from oracles.line_array import simulate
from torch import Tensor

import torchdt.filter.bp.evidence
import torchdt.filter.intensity.undetected
import torchdt.filter.placement
import torchdt.filter.proposal.adapted
import torchdt.filter.proposal.moved
from torchdt.core.random import RandomStreams
from torchdt.filter.direct import DirectTracker
from torchdt.filter.likelihood import log_likelihood
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.model import Model
from torchdt.model.prior import data_priors

STEPS = 6
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


def snapshots() -> Tensor:
    """Two sources in one sequence, one in the other, `(2, K, I, J, M)`."""
    return torch.stack([simulate(1, *TWO, steps=STEPS)[0], simulate(2, *ONE, steps=STEPS)[0]])


def measurements() -> Measurement:
    """Statistics of `snapshots`."""
    return from_snapshots(snapshots())


def model(dtype: torch.dtype = torch.float64, **changed: Tensor) -> Model:
    """Of the numbers in `START`, some of them changed."""
    values = {name: torch.tensor(value, dtype=dtype) for name, value in START.items()}
    return Model().with_numbers(values | changed)


def evaluate(
    tracker: DirectTracker, measurement: Measurement, seeds: Sequence[int] = (1, 2), **options: int | None
) -> Tensor:
    """Evidence `(B, K)` with random numbers of the seeds."""
    streams = RandomStreams.from_seeds(seeds, (len(seeds),), tracker.region.low.dtype)
    return log_likelihood(tracker, measurement, data_priors(measurement), streams, **options)


def differentiate(
    tracker: DirectTracker,
    measurement: Measurement,
    at: Model | None = None,
    seeds: Sequence[int] = (1, 2),
    **options: int | None,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Evidence `(B, K)`, and the gradient of its sum in each number of the model, zero where none."""
    at = model(tracker.region.low.dtype) if at is None else at
    leaves = {name: value.clone().requires_grad_() for name, value in at.known().items()}
    found = evaluate(tracker.with_model(at.with_numbers(leaves)), measurement, seeds, **options)
    slopes = torch.autograd.grad(found.sum(), leaves.values(), materialize_grads=True)
    return found.detach(), dict(zip(leaves, slopes, strict=True))


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
    """Record what is constant to a gradient: particles, picks and configurations."""
    with contextlib.ExitStack() as stack:
        tapes = []
        for module, name in (
            (torchdt.filter.proposal.moved, "draw_adapted"),
            (torchdt.filter.proposal.adapted, "adapt"),
            (torchdt.filter.placement, "search"),
            (torchdt.filter.intensity.undetected, "left_by"),
            (torchdt.filter.intensity.undetected, "log_ratio"),
            (torchdt.filter.bp.evidence, "draw_configurations"),
        ):
            tapes.append(Tape(getattr(module, name)))
            stack.enter_context(mock.patch.object(module, name, tapes[-1]))
        yield tapes


def rewind(tapes: list[Tape]) -> None:
    """Play back from the start."""
    for tape in tapes:
        tape.position = 0
