"""Settings of the detectors, checked once when they are made."""

import math
from dataclasses import dataclass

from torchdt.errors import require


@dataclass
class DetectorConfig:
    """What every detector shares.

    Attributes:
        points: number Q of points per step at most.
        separation: least distance of two points in each coordinate, in birth cells: points that are closer in
            every coordinate count as one.
        threshold: log-likelihood ratio in nats that a point must reach.
        refine: look for the peak between the points of the grid.
    """

    points: int = 10
    separation: float = 2.0
    threshold: float = 12.0
    refine: bool = True

    def __post_init__(self) -> None:
        self._require("points", self.points >= 1, "a positive integer")
        self._require("separation", 1 <= self.separation < math.inf, "a number from 1 up")
        self._require("threshold", 0 <= self.threshold < math.inf, "a number from 0 up")

    def _require(self, name: str, holds: bool, expected: str) -> None:
        require(holds, f"tracker.detector.{name}", getattr(self, name), expected)


@dataclass
class PursuitConfig(DetectorConfig):
    """Matching pursuit.

    Attributes:
        pick_threshold: log-likelihood ratio in nats that the best cell must reach to be picked. Lower than
            `threshold`: close sources come apart only when both are picked and moved together.
    """

    pick_threshold: float = 9.3

    def __post_init__(self) -> None:
        super().__post_init__()
        positive = 0 <= self.pick_threshold < math.inf
        self._require("pick_threshold", positive, "a number from 0 up")


@dataclass
class SblConfig(DetectorConfig):
    """Multi-frequency sparse Bayesian learning.

    Attributes:
        sources: number K of columns whose span the noise estimate leaves out.
        min_iterations, max_iterations: of the fixed-point update.
        tolerance: relative change of the powers (sum of absolute values) at which the iteration stops.
        prune: columns whose power is below this share of the largest one are left out from then on.
    """

    sources: int = 3
    min_iterations: int = 15
    max_iterations: int = 300
    tolerance: float = 1e-4
    prune: float = 1e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require("sources", self.sources >= 1, "a positive integer")
        self._require("min_iterations", self.min_iterations >= 1, "a positive integer")
        enough = self.max_iterations >= self.min_iterations
        self._require("max_iterations", enough, f"at least min_iterations, {self.min_iterations}")
        self._require("tolerance", 0 < self.tolerance < 1, "a number strictly between 0 and 1")
        self._require("prune", 0 <= self.prune < 1, "a number from 0 up to below 1")
