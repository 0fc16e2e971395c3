"""Settings of the trackers, checked once when they are made."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from torch import Tensor

from torchdt.core.ranges import (
    Checked,
    Count,
    InnerProbability,
    OneOf,
    Passes,
    Power,
    Share,
)
from torchdt.model.motion.driving import GRADIENTS

SCHEDULES = ("sequential", "flooding")
PROPOSALS = ("adapted", "prior")
EVIDENCES = ("sampled", "gaussian")


@dataclass
class ObjectConfig(Checked):
    """What every tracker shares: how many potential objects, their particles, and when they count.

    Attributes:
        slots: number N of potential objects carried at most.
        particles: number P of state particles of each object.
        declare: T_dec, existence probability above which an object is reported.
        prune: T_pru, existence probability below which an object is dropped.
        roughening: kernel width after resampling, in standard deviations of the particle set.
        resample_below: resample where the effective sample size is below this share of the particles.
    """

    KEY: ClassVar[str] = "tracker"

    slots: Count = 16
    particles: Count = 1000
    declare: InnerProbability = 0.5
    prune: InnerProbability = 1e-2
    roughening: Share = 0.1
    resample_below: Share = 0.5


@dataclass
class TrackerConfig(ObjectConfig):
    """Direct tracking; defaults of Liang and Meyer, Sec. IV, where given.

    Attributes:
        power_points: number G of support points of each tone's power.
        noise_points: number E of support points of each tone's noise variance.
        births: number of cells in which new objects are considered per step, at most.
        sweeps: BP passes over all objects per step.
        schedule: `sequential` (strongest first) or `flooding`.
        proposal: `adapted` to the likelihood, or `prior`: particles as predicted, new ones uniform in a cell.
            Adapted proposals draw new particles in every step and need neither resampling nor roughening.
        mixture_components: Gaussians, at most, by which an adapted proposal predicts an object: one for each
            cluster of its particles. 1: one of the mean and covariance of them all, an assumed density.
        rounds: rounds of fitting a proposal, at most.
        round_size: sample size of each round.
        mismatch_share: share of each tone's energy that responses do not cover, where the field knows how its
            response scatters; None leaves it to the calibration.
        evidence: log p(z_k | z_1..k-1) by importance sampling (`sampled`), or `gaussian`: cheap and crude.
        evidence_samples: joint configurations drawn for the sampled evidence.
        gradient: of the likelihood through motion: `score` (particles stay, weights move with the parameters)
            or `reparameterised` (particles move).
        power_max: upper limit of the uniform power prior in squared data units; None takes it from the data.
        noise_max: upper limit of the uniform noise prior in squared data units; None takes it from the data.
    """

    power_points: Count = 16
    noise_points: Count = 64
    births: Count = 10
    sweeps: Passes = 2
    schedule: Annotated[str, OneOf(SCHEDULES)] = "sequential"
    proposal: Annotated[str, OneOf(PROPOSALS)] = "adapted"
    mixture_components: Count = 4
    rounds: Passes = 6
    round_size: Count = 128
    mismatch_share: list[InnerProbability] | None = None
    evidence: Annotated[str, OneOf(EVIDENCES)] = "sampled"
    evidence_samples: Count = 64
    gradient: Annotated[str, OneOf(GRADIENTS)] = "score"
    power_max: Power | None = None
    noise_max: Power | None = None

    def pick_threshold(self, birth_log_odds: Tensor) -> Tensor:
        """Log-likelihood ratio that can just lift a new object over the pruning threshold.

        Args:
            birth_log_odds: of a new object in one cell, `(*batch,)`.
        """
        return math.log(self.prune / (1 - self.prune)) - birth_log_odds
