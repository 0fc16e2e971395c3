"""What every tracker offers."""

from collections.abc import Callable
from typing import Protocol, TypeVar

import torch

from torchdt.detect.dictionary import Dictionary
from torchdt.field.base import Field
from torchdt.history import TrackHistory
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors
from torchdt.model.region import Region
from torchdt.prepare import Prepared
from torchdt.random import RandomStreams
from torchdt.scenario.recording import Recording

State = TypeVar("State")


class Tracker(Protocol[State]):
    """From array data to tracks, step by step; inherit from it for `run`.

    Attributes:
        field: array response.
        region: region of interest; its dtype and device are those of the tracker.
        dictionary: responses of the field at the centres of the birth cells.
    """

    field: Field
    region: Region
    dictionary: Dictionary

    def prepare(self, recording: Recording) -> Prepared:
        """Bring a recording into the form and units in which the tracker takes it."""
        ...

    def init(self, priors: Priors) -> State:
        """State before the first step: no objects."""
        ...

    def step(
        self, state: State, measurement: Measurement, priors: Priors, streams: RandomStreams
    ) -> tuple[State, TrackHistory]:
        """Take in one step of data, batch `(*batch,)`.

        Returns:
            The new state, and the estimates of this step: a `TrackHistory` without its time dimension.
        """
        ...

    def run(
        self,
        measurement: Measurement,
        priors: Priors,
        streams: RandomStreams,
        on_step: Callable[[int, TrackHistory], None] | None = None,
    ) -> TrackHistory:
        """Track whole sequences.

        Args:
            measurement: statistics of batch `(*batch, K)`.
            priors: limits of the priors, batch `(*batch,)`.
            streams: random numbers of batch `(*batch,)`.
            on_step: called after each step with its index and the estimates of that step.
        """
        batch_dims = priors.noise_max.ndim - 1
        state, steps = self.init(priors), []
        for k in range(measurement.num_snapshots.shape[batch_dims]):
            state, estimate = self.step(state, measurement.at(k), priors, streams)
            steps.append(estimate)
            if on_step is not None:
                on_step(k, estimate)
        return TrackHistory(*(torch.stack(parts, batch_dims) for parts in zip(*steps, strict=True)))
