"""What every tracker offers."""

import abc
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from typing import Any, Generic, NamedTuple, Self, TypeVar

from torchdt.core.random import RandomStreams
from torchdt.data.prepare import Prepared
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField
from torchdt.filter.breakdown import step_or_miss
from torchdt.filter.config import ObjectConfig
from torchdt.filter.history import StepEstimate, TrackHistory
from torchdt.filter.proposal.dictionary import Dictionary, build_dictionary
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors
from torchdt.model.region import Region

State = TypeVar("State", bound=tuple[Any, ...])


class Past(NamedTuple, Generic[State]):
    """What a run has done so far.

    Attributes:
        state: after the last step.
        history: estimates of all steps up to it, `(*batch, k, ...)`.
    """

    state: State
    history: TrackHistory


class Tracker(abc.ABC, Generic[State]):
    """Base of all trackers: from array data to tracks, step by step.

    Attributes:
        field: array response.
        region: region of interest; its dtype and device are those of the tracker.
        config: numbers of the model and the filter.
    """

    field: BaseField
    region: Region
    config: ObjectConfig

    @cached_property
    def dictionary(self) -> Dictionary:
        """Responses of the field at the centres of the birth cells, evaluated when first asked for."""
        return build_dictionary(self.field, self.region)

    @abc.abstractmethod
    def select(self, sequences: slice) -> Self:
        """The same tracker for some sequences of its batch; what all sequences share stays shared."""

    @abc.abstractmethod
    def prepare(self, recording: Recording) -> Prepared:
        """Bring a recording into the form and units in which the tracker takes it."""

    @abc.abstractmethod
    def init(self, priors: Priors) -> State:
        """State before the first step: no objects."""

    @abc.abstractmethod
    def step(
        self, state: State, measurement: Measurement, priors: Priors, streams: RandomStreams
    ) -> tuple[State, StepEstimate]:
        """Take in one step of data, batch `(*batch,)`.

        Returns:
            The new state, and the estimates of this step.
        """

    def stream(
        self, measurements: Iterable[Measurement], priors: Priors, streams: RandomStreams
    ) -> Iterator[StepEstimate]:
        """Track data as they arrive: only the belief after the last step is kept.

        Steps that break down count as missing, see `step_or_miss`.

        For tracking without gradients, take the estimates under `torch.inference_mode()`.

        Args:
            measurements: statistics of one step after another, each of batch `(*batch,)`.
            priors: limits of the priors, batch `(*batch,)`.
            streams: random numbers of batch `(*batch,)`.

        Yields:
            The estimates of each step.
        """
        state = self.init(priors)
        for step, measurement in enumerate(measurements):
            state, estimate = step_or_miss(self, state, measurement, priors, streams, step)
            yield estimate

    def run(
        self,
        measurement: Measurement,
        priors: Priors,
        streams: RandomStreams,
        on_step: Callable[[int, State, StepEstimate], None] | None = None,
        past: Past[State] | None = None,
        first: int = 0,
    ) -> TrackHistory:
        """Track whole sequences. Steps that break down count as missing, see `step_or_miss`.

        Args:
            measurement: statistics of batch `(*batch, K)`.
            priors: limits of the priors, batch `(*batch,)`.
            streams: random numbers of batch `(*batch,)`.
            on_step: called after each step with its index, the state, and the estimates of that step.
            past: what was done of these sequences, to go on from; the streams are where that ended.
            first: number of the first sequence, for messages.

        Returns:
            History of batch `(*batch,)` and K steps, those of the past among them.
        """
        batch_dims = priors.noise_max.ndim - 1
        state = self.init(priors) if past is None else past.state
        steps = [] if past is None else past.history.steps(batch_dims)
        for k in range(len(steps), measurement.num_snapshots.shape[batch_dims]):
            state, estimate = step_or_miss(self, state, measurement.at(k), priors, streams, k, first)
            steps.append(estimate)
            if on_step is not None:
                on_step(k, state, estimate)
        return TrackHistory.of_steps(steps, batch_dims)
