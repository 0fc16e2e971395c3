"""Settings of the trackers, checked once when they are made."""

import math
from dataclasses import dataclass

from torch import Tensor

from torchdt.errors import require
from torchdt.model.gamma_chain import LEAST_SHAPE
from torchdt.particles.transition import GRADIENTS

SCHEDULES = ("sequential", "flooding")
PROPOSALS = ("adapted", "prior")
EVIDENCES = ("sampled", "gaussian")


@dataclass
class ObjectConfig:
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

    slots: int = 16
    particles: int = 1000
    survival: float = 0.95
    birth_mean: float = 1e-4
    declare: float = 0.5
    prune: float = 1e-2
    driving_variance: list[float] | None = None
    roughening: float = 0.1
    resample_below: float = 0.5

    def __post_init__(self) -> None:
        for name in ("slots", "particles"):
            self._require(name, getattr(self, name) >= 1, "a positive integer")
        self._require("birth_mean", 0 < self.birth_mean < math.inf, "a positive number")
        for name in ("survival", "declare", "prune"):
            self._require(name, 0 < getattr(self, name) < 1, "a probability strictly between 0 and 1")
        for name in ("roughening", "resample_below"):
            self._require(name, 0 <= getattr(self, name) <= 1, "a number from 0 to 1")
        self._check_list("driving_variance")

    def _require(self, name: str, holds: bool, expected: str) -> None:
        require(holds, f"tracker.{name}", getattr(self, name), expected)

    def _check_list(self, name: str, below: float = math.inf) -> None:
        values = getattr(self, name)
        holds = values is None or (len(values) > 0 and all(0 < v < below for v in values))
        self._require(name, holds, f"positive numbers below {below}, or null")


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

    power_points: int = 16
    noise_points: int = 64
    power_shape: float = 1e4
    noise_shape: float = 1e2
    births: int = 10
    sweeps: int = 2
    schedule: str = "sequential"
    proposal: str = "adapted"
    rounds: int = 6
    round_size: int = 128
    likelihood_power: float = 1.0
    effective_count: float | None = None
    mismatch_share: list[float] | None = None
    evidence: str = "sampled"
    evidence_samples: int = 64
    gradient: str = "score"
    power_max: float | None = None
    noise_max: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        positive = ("power_points", "noise_points", "births", "sweeps", "rounds", "round_size")
        for name in (*positive, "evidence_samples"):
            self._require(name, getattr(self, name) >= 1, "a positive integer")
        for name in ("power_shape", "noise_shape"):
            expected = f"a finite number of at least {LEAST_SHAPE:g}"
            self._require(name, LEAST_SHAPE <= getattr(self, name) < math.inf, expected)
        for name in ("power_max", "noise_max", "effective_count"):
            limit = getattr(self, name)
            self._require(name, limit is None or 0 < limit < math.inf, "a positive number or null")
        self._require("likelihood_power", 0 < self.likelihood_power <= 1, "a number above 0, up to 1")
        self._check_list("mismatch_share", below=1.0)
        self._require("evidence", self.evidence in EVIDENCES, " or ".join(EVIDENCES))
        self._require("gradient", self.gradient in GRADIENTS, " or ".join(GRADIENTS))
        self._require("proposal", self.proposal in PROPOSALS, " or ".join(PROPOSALS))
        self._require("schedule", self.schedule in SCHEDULES, " or ".join(SCHEDULES))

    def pick_threshold(self, birth_log_odds: Tensor) -> Tensor:
        """Log-likelihood ratio that can just lift a new object over the pruning threshold.

        Args:
            birth_log_odds: of a new object in one cell, `(*batch,)`.
        """
        return math.log(self.prune / (1 - self.prune)) - birth_log_odds
