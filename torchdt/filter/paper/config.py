"""Settings of the paper's own graph."""

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from torchdt.core.ranges import Count, Passes, Power
from torchdt.core.resampling import Systematic
from torchdt.filter.config import ObjectConfig

if TYPE_CHECKING:
    from torchdt.core.resampling import Resampler
else:  # configurations have no protocols
    Resampler = Any


@dataclass
class PaperConfig(ObjectConfig):
    """Direct tracking on the factor graph of Liang and Meyer; defaults of their Sec. IV, where given.

    Attributes:
        power_particles: number G of particles of each tone's power.
        noise_particles: number E of particles of each tone's noise variance.
        births: number of cells in which new objects are considered in every step.
        resampler: of states, powers and noise variances.
        iterations: of the messages of a step, all of which are sent at once.
        power_max: upper limit of the uniform power prior in squared data units; None takes it from the data.
        noise_max: upper limit of the uniform noise prior in squared data units; None takes it from the data.
    """

    power_particles: Count = 50
    noise_particles: Count = 1000
    births: Count = 10
    iterations: Passes = 3
    power_max: Power | None = None
    noise_max: Power | None = None
    resampler: Resampler = field(default_factory=partial(Systematic, below=1.0, roughening=0.0))
