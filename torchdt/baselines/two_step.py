"""Conventional tracking in two steps: detect points in the array data, then track the points."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import torch

from torchdt.baselines.detect.config import DetectorConfig, PursuitConfig, SblConfig
from torchdt.baselines.detect.points import Detector
from torchdt.baselines.detect.pursuit import MatchingPursuit
from torchdt.baselines.detect.sbl import SparseBayesianLearning
from torchdt.baselines.mot.config import PointConfig
from torchdt.baselines.mot.likelihood import GaussianPosition
from torchdt.baselines.mot.tracker import PointState, PointTracker
from torchdt.core.errors import InputError
from torchdt.core.linalg import check_finite
from torchdt.core.random import RandomStreams
from torchdt.data.prepare import Prepared, check_step, prepare
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField, Field
from torchdt.field.wrapped import CompletedField
from torchdt.filter.history import StepEstimate
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.tracker import Tracker
from torchdt.model.measurement import Measurement
from torchdt.model.motion.base import Motion
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.prior import Priors
from torchdt.model.region import Region


@dataclass
class TwoStepConfig(PointConfig):
    """A detector, and the tracking of its points.

    Attributes:
        detector: settings of one of the detectors; their type says which.
    """

    detector: DetectorConfig = field(default_factory=PursuitConfig)


class TwoStepTracker(Tracker[PointState]):
    """Tracks what a detector finds; the reference that direct tracking is compared with.

    Args:
        field: array response.
        region: region of interest, less where the field says that no object can be; its dtype and device are
            those of the tracker.
        step_s: time step in seconds.
        config: numbers of the detector and the tracker.
        motion: of objects; None is constant velocity.

    Attributes:
        field: as the tracker asks it: of positions alone too.

    Raises:
        InputError: where field, region and settings do not fit each other.
    """

    field: BaseField
    config: TwoStepConfig

    def __init__(
        self,
        field: Field,
        region: Region,
        step_s: float,
        config: TwoStepConfig,
        motion: Motion | None = None,
    ):
        motion = ConstantVelocity() if motion is None else motion
        region = region.within(field, motion)
        self.field, self.region, self.config = CompletedField(field, region.complete), region, config
        likelihood = GaussianPosition(region, config.spread_in(region), motion)
        self.tracker = PointTracker(region, step_s, config, likelihood, motion)

    @cached_property
    def detector(self) -> Detector:
        """The detector of the settings, made when first asked for: it holds the dictionary.

        Raises:
            InputError: where the settings are those of no known detector, or do not fit the array.
        """
        return build_detector(self.field, self.region, self.dictionary, self.config.detector)

    def select(self, sequences: slice) -> Self:
        """The same tracker for some sequences of its batch; what all sequences share stays shared."""
        field = self.field.select(sequences)
        if field is self.field:
            return self
        return type(self)(field, self.region, self.tracker.step_s, self.config, self.tracker.motion)

    def prepare(self, recording: Recording) -> Prepared:
        """Scale a recording, see `prepare`.

        Raises:
            InputError: where it does not fit the tracker; also where its steps are of another length.
        """
        check_step(recording, self.tracker.step_s)
        return prepare(recording, self.field, self.region)

    def init(self, priors: Priors) -> PointState:
        """State before the first step: no objects."""
        *batch, num_tones = priors.noise_max.shape
        return self.tracker.init(batch, num_tones)

    def step(
        self, state: PointState, measurement: Measurement, priors: Priors, streams: RandomStreams
    ) -> tuple[PointState, StepEstimate]:
        """Take in one step of data; see `PointTracker.step` for what the estimates mean.

        Raises:
            NumericalError: where a covariance is not positive definite, or the noise or a message not finite.
        """
        with torch.no_grad():
            points = self.detector(measurement)
            check_finite(points.noise, "noise variance of the points")
            return self.tracker.step(state, points, streams)


def build_detector(field: Field, region: Region, dictionary: Dictionary, config: DetectorConfig) -> Detector:
    """The detector that settings are for.

    Raises:
        InputError: where there is none.
    """
    if isinstance(config, PursuitConfig):
        return MatchingPursuit(field, region, dictionary, config)
    if isinstance(config, SblConfig):
        return SparseBayesianLearning(field, region, dictionary, config)
    raise InputError.of_key("tracker.detector", type(config).__name__, "PursuitConfig or SblConfig")
