"""Settings of conventional tracking, checked once when they are made."""

import math
from dataclasses import dataclass, field

from torchdt.config import ObjectConfig
from torchdt.model.region import Region


@dataclass
class PointConfig(ObjectConfig):
    """Conventional multiobject tracking of points.

    Attributes:
        detection_probability: p_D of an object in one step.
        clutter_mean: mu_c, mean number of false points per step, uniform in the whole region.
        spread: standard deviation of a point around its object, in birth cells, by name of the coordinate;
            half a cell where it is not named.
        iterations: of the data association, at most.
        tolerance: largest change of a message, in nats, at which the data association stops.
    """

    # A new object starts at about birth_mean / clutter_mean, and must survive that.
    birth_mean: float = 1e-2
    prune: float = 1e-4
    detection_probability: float = 0.9
    clutter_mean: float = 1.0
    spread: dict[str, float] = field(default_factory=dict)
    iterations: int = 1000
    tolerance: float = 1e-5

    def __post_init__(self) -> None:
        super().__post_init__()
        probability = 0 < self.detection_probability < 1
        self._require("detection_probability", probability, "a probability strictly between 0 and 1")
        for name in ("clutter_mean", "tolerance"):
            self._require(name, 0 < getattr(self, name) < math.inf, "a positive number")
        positive = all(0 < value < math.inf for value in self.spread.values())
        self._require("spread", positive, "positive numbers")
        self._require("iterations", self.iterations >= 1, "a positive integer")

    def spread_in(self, region: Region) -> list[float]:
        """Standard deviation of a point in each of the d coordinates of a region, in its units."""
        return [self.spread.get(c.name, 0.5) * (c.high - c.low) / c.num_cells for c in region.coordinates]
