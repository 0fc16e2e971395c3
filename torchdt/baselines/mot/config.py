"""Settings of conventional tracking, checked once when they are made."""

from dataclasses import dataclass, field

from torchdt.core.ranges import BirthMean, Count, InnerProbability, Positive
from torchdt.filter.config import ObjectConfig
from torchdt.model.region import Region


@dataclass
class PointConfig(ObjectConfig):
    """Conventional multiobject tracking of points.

    Attributes:
        survival: p_s, probability to go on existing for one step.
        birth_mean: mu_B, mean number of new objects per step in the whole region.
        detection_probability: p_D of an object in one step.
        clutter_mean: mu_c, mean number of false points per step, uniform in the whole region.
        spread: standard deviation of a point around its object, in birth cells, by name of the coordinate;
            half a cell where it is not named.
        iterations: of the data association, at most.
        tolerance: largest change of a message, in nats, at which the data association stops.
    """

    survival: InnerProbability = 0.95
    # A new object starts at about birth_mean / clutter_mean, and must survive that.
    birth_mean: BirthMean = 1e-2
    prune: InnerProbability = 1e-4
    detection_probability: InnerProbability = 0.9
    clutter_mean: BirthMean = 1.0
    spread: dict[str, Positive] = field(default_factory=dict)
    iterations: Count = 1000
    tolerance: Positive = 1e-5

    def spread_in(self, region: Region) -> list[float]:
        """Standard deviation of a point in each of the d coordinates of a region, in its units."""
        return [self.spread.get(c.name, 0.5) * (c.high - c.low) / c.num_cells for c in region.coordinates]
