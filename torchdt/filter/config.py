"""Settings of the trackers, checked once when they are made."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from torch import Tensor

from torchdt.core.ranges import (
    BirthMean,
    Checked,
    Count,
    InnerProbability,
    OneOf,
    Passes,
    Positive,
    PositiveShare,
    Power,
    Range,
    Share,
)
from torchdt.model.gamma_chain import LEAST_SHAPE
from torchdt.model.motion.driving import GRADIENTS

SCHEDULES = ("sequential", "flooding")
PROPOSALS = ("adapted", "prior")
EVIDENCES = ("sampled", "gaussian")
Shape = Annotated[float, Range(f"a finite number of at least {LEAST_SHAPE:g}", low=LEAST_SHAPE)]
"""Of the Gamma transitions whose mean the support points keep."""


@dataclass
class ObjectConfig(Checked):
    """What every tracker shares: numbers of the model of potential objects, and their particles.

    Attributes:
        slots: number N of potential objects carried at most.
        particles: number P of state particles of each object.
        survival: p_s, probability to go on existing for one step.
        birth_mean: mu_B, mean number of new objects per step in the whole region.
        declare: T_dec, existence probability above which an object is reported.
        prune: T_pru, existence probability below which an object is dropped.
        driving_variance: variance of each coordinate's driving noise; None takes the region's.
        roughening: kernel width after resampling, in standard deviations of the particle set.
        resample_below: resample where the effective sample size is below this share of the particles.
    """

    KEY: ClassVar[str] = "tracker"

    slots: Count = 16
    particles: Count = 1000
    survival: InnerProbability = 0.95
    birth_mean: BirthMean = 1e-4
    declare: InnerProbability = 0.5
    prune: InnerProbability = 1e-2
    driving_variance: list[Positive] | None = None
    roughening: Share = 0.1
    resample_below: Share = 0.5


@dataclass
class TrackerConfig(ObjectConfig):
    """Direct tracking; defaults of Liang and Meyer, Sec. IV, where given.

    Attributes:
        power_points: number G of support points of each tone's power.
        noise_points: number E of support points of each tone's noise variance.
        power_shape: c_gamma, shape of the Gamma transition of the powers, at least 1.
        noise_shape: c_eta, shape of the Gamma transition of the noise variances, at least 1.
        births: number of cells in which new objects are considered per step, at most.
        sweeps: BP passes over all objects per step.
        schedule: `sequential` (strongest first) or `flooding`.
        proposal: `adapted` to the likelihood, or `prior`: particles as predicted, new ones uniform in a cell.
            Adapted proposals draw new particles in every step and need neither resampling nor roughening.
        rounds: rounds of fitting a proposal, at most.
        round_size: sample size of each round.
        likelihood_power: power to which the likelihood is raised; below 1 the snapshots count as fewer.
        effective_count: snapshots that every sample covariance counts as; None takes the number in the data.
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
    power_shape: Shape = 1e4
    noise_shape: Shape = 1e2
    births: Count = 10
    sweeps: Passes = 2
    schedule: Annotated[str, OneOf(SCHEDULES)] = "sequential"
    proposal: Annotated[str, OneOf(PROPOSALS)] = "adapted"
    rounds: Passes = 6
    round_size: Count = 128
    likelihood_power: PositiveShare = 1.0
    effective_count: Positive | None = None
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
