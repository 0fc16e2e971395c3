"""Settings of the detectors, checked once when they are made."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Count, Nats, Range


@dataclass
class DetectorConfig(Checked):
    """What every detector shares.

    Attributes:
        points: number Q of points per step at most.
        separation: least distance of two points in each coordinate, in birth cells: points that are closer in
            every coordinate count as one.
        threshold: log-likelihood ratio in nats that a point must reach.
        refine: look for the peak between the points of the grid.
    """

    KEY: ClassVar[str] = "tracker.detector"

    points: Count = 10
    separation: Annotated[float, Range("a number from 1 up", low=1, most=1e6)] = 2.0
    threshold: Nats = 12.0
    refine: bool = True


@dataclass
class PursuitConfig(DetectorConfig):
    """Matching pursuit.

    Attributes:
        pick_threshold: log-likelihood ratio in nats that the best cell must reach to be picked. Lower than
            `threshold`: close sources come apart only when both are picked and moved together.
    """

    pick_threshold: Nats = 9.3


@dataclass
class SblConfig(DetectorConfig):
    """Multi-frequency sparse Bayesian learning.

    Attributes:
        sources: number K of columns whose span the noise estimate leaves out.
        min_iterations, max_iterations: of the fixed-point update.
        tolerance: relative change of the powers (sum of absolute values) at which the iteration stops.
        prune: columns whose power is below this share of the largest one are left out from then on.
    """

    sources: Count = 3
    min_iterations: Count = 15
    max_iterations: Count = 300
    tolerance: Annotated[float, Range("a number strictly between 0 and 1", 0, 1, True, True)] = 1e-4
    prune: Annotated[float, Range("a number from 0 up to below 1", 0, 1, open_high=True)] = 1e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        enough = self.max_iterations >= self.min_iterations
        expected = f"at least min_iterations, {self.min_iterations}"
        require(enough, f"{self.KEY}.max_iterations", self.max_iterations, expected)
