"""Steps in which a tracker breaks down count as missing, for the sequences concerned and no other."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, TypeVar

import torch

from torchdt.core.linalg import BREAKDOWN, NumericalError
from torchdt.core.random import RandomStreams
from torchdt.core.trees import join, take_sequences
from torchdt.filter.history import StepEstimate
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors

if TYPE_CHECKING:
    from torchdt.filter.tracker import Tracker

State = TypeVar("State", bound=tuple[Any, ...])

log = logging.getLogger(__name__)


def step_or_miss(
    tracker: Tracker[State],
    state: State,
    measurement: Measurement,
    priors: Priors,
    streams: RandomStreams,
    step: int,
    first: int = 0,
) -> tuple[State, StepEstimate]:
    """Take in one step of data; where the numbers break down, go on without these data.

    Then each sequence takes the step alone, with the random numbers that it would have had, so that it gives
    what it gives without the others. One that breaks down alone is predicted, as if its data were missing;
    a warning names it, and `StepEstimate.failed` holds.

    Args:
        tracker: takes the step.
        state: after the last step, batch `(B,)` or none.
        measurement: of the step.
        priors: limits of the priors.
        streams: random numbers.
        step: number of the step, for messages.
        first: number of the first sequence, for messages.

    Raises:
        NumericalError: where even the prediction breaks down, naming sequence and step.
    """
    before = streams.snapshot()
    try:
        return tracker.step(state, measurement, priors, streams)
    except BREAKDOWN as error:
        streams.skip_to(before)
        if not streams.batch_shape:
            return _miss(tracker, state, measurement, priors, streams, f"step {step}", error)
        (number,) = streams.batch_shape
    parts = []
    for b in range(number):
        own = RandomStreams([streams.generators[b]], (1,), streams.dtype)
        row = torch.tensor([b], device=measurement.factor.device)
        arguments = take_sequences((state, measurement, priors), row)
        one = tracker.select(slice(b, b + 1))
        try:
            parts.append(one.step(*arguments, own))
        except BREAKDOWN as error:
            own.skip_to(before[b : b + 1])
            parts.append(_miss(one, *arguments, own, f"sequence {first + b}, step {step}", error))
    return join(parts)


def _miss(
    tracker: Tracker[State],
    state: State,
    measurement: Measurement,
    priors: Priors,
    streams: RandomStreams,
    name: str,
    error: Exception,
) -> tuple[State, StepEstimate]:
    """The step without its data."""
    log.warning("%s broke down and counts as missing: %s", name, error)
    try:
        state, estimate = tracker.step(state, measurement.silent(), priors, streams)
    except BREAKDOWN as worse:
        raise NumericalError(f"{name}, even without data: {worse}") from worse
    return state, estimate._replace(failed=torch.ones_like(estimate.failed))
