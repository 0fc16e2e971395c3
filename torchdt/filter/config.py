"""Settings of the trackers, checked once when they are made."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.core.ranges import (
    Checked,
    Count,
    InnerProbability,
    Passes,
    Power,
)
from torchdt.core.resampling import Resampler, Systematic
from torchdt.filter.bp.evidence import Evidence, SampledEvidence
from torchdt.filter.bp.marginals import Joint, Marginals
from torchdt.filter.bp.schedule import Schedule, Sequential
from torchdt.filter.intensity.settings import Intensity, UndetectedModel
from torchdt.filter.interference.settings import FreeSignatures, Interference
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.base import Proposal
from torchdt.model.motion.driving import Gradient, Score

PARTS: Mapping[str, Any] = {
    "resampler": Resampler,
    "schedule": Schedule,
    "proposal": Proposal,
    "marginals": Marginals,
    "undetected": UndetectedModel,
    "interference": Interference,
    "evidence": Evidence,
    "gradient": Gradient,
}
"""Settings that are objects, and the protocol of each."""

if not TYPE_CHECKING:  # configurations have no protocols
    Evidence = Gradient = Interference = Marginals = Proposal = Resampler = Schedule = UndetectedModel = Any


@dataclass
class ObjectConfig(Checked):
    """What every tracker shares: how many potential objects, their particles, and when they count.

    Attributes:
        slots: number N of potential objects carried at most.
        particles: number P of state particles of each object.
        declare: T_dec, existence probability above which an object is reported.
        prune: T_pru, existence probability below which an object is dropped.
        resampler: of particles as predicted; those drawn around the data need none.
    """

    KEY: ClassVar[str] = "tracker"

    slots: Count = 16
    particles: Count = 1000
    declare: InnerProbability = 0.5
    prune: InnerProbability = 1e-2
    resampler: Resampler = field(default_factory=Systematic)

    def part_names(self) -> list[str]:
        """Names of the settings that are objects."""
        return [f.name for f in fields(self) if f.name in PARTS]

    def check_parts(self) -> None:
        """See that the parts are objects of their kind, as a tracker needs them.

        Raises:
            InputError: naming the first that is not.
        """
        for name in self.part_names():
            part, kind = getattr(self, name), PARTS[name]
            if not isinstance(part, kind):
                expected = f"an object that follows {kind.__module__}.{kind.__name__}"
                raise InputError.of_key(f"{self.KEY}.{name}", part, expected)


@dataclass
class TrackerConfig(ObjectConfig):
    """Direct tracking; defaults of Liang and Meyer, Sec. IV, where given.

    Attributes:
        power_points: number G of support points of each tone's power.
        noise_points: number E of support points of each tone's noise variance.
        births: number of cells in which new objects are considered per step, at most.
        sweeps: BP passes over all objects per step.
        schedule: order of the messages.
        proposal: where particles are: drawn anew around the data, or as predicted.
        report_silent: whether objects that exist are reported while they do not transmit; if not, existence
            and transmission together have to be probable.
        mismatch_share: share of each tone's energy that responses do not cover, where the field knows how its
            response scatters; None leaves it to the calibration.
        marginals: of objects that overlap: from joint configurations, or as the messages leave them.
        undetected: intensity of undetected objects, from which births rest on many steps; or nothing.
        interference: what is heard and is no object: signals of free spatial signature, or nothing.
        evidence: how log p(z_k | z_1..k-1) is estimated.
        gradient: of the likelihood through motion: particles stay and weights move, or particles move.
        power_max: upper limit of the uniform power prior in squared data units; None takes it from the data.
        noise_max: upper limit of the uniform noise prior in squared data units; None takes it from the data.
    """

    power_points: Count = 16
    noise_points: Count = 64
    births: Count = 10
    sweeps: Passes = 2
    schedule: Schedule = field(default_factory=Sequential)
    proposal: Proposal = field(default_factory=Adapted)
    report_silent: bool = True
    mismatch_share: list[InnerProbability] | None = None
    marginals: Marginals = field(default_factory=Joint)
    undetected: UndetectedModel = field(default_factory=Intensity)
    interference: Interference = field(default_factory=FreeSignatures)
    evidence: Evidence = field(default_factory=SampledEvidence)
    gradient: Gradient = field(default_factory=Score)
    power_max: Power | None = None
    noise_max: Power | None = None

    def pick_threshold(self, birth_log_odds: Tensor) -> Tensor:
        """Log-likelihood ratio that can just lift a new object over the pruning threshold.

        Args:
            birth_log_odds: of a new object in one cell, `(*batch,)`.
        """
        return math.log(self.prune / (1 - self.prune)) - birth_log_odds
