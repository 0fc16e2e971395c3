"""Where new objects come from: an intensity that is carried from step to step, or single steps alone."""

import logging
import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.ranges import Checked, Count, InnerProbability, Nats, Positive, Range, Share
from torchdt.field.base import BaseField, of_each
from torchdt.filter.intensity.grid import lay_grid
from torchdt.filter.intensity.undetected import Undetected
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.model.model import Model
from torchdt.model.region import Region

log = logging.getLogger(__name__)

AROUND = ((0.15, None), (0.25, -1), (0.45, 0), (0.15, 1))
"""Share of the tones of an object that are silent, and that are one level below, at and above its own: the
mean power is that of its level. Sources whose tones differ, or that lack some, then cost little."""


@runtime_checkable
class UndetectedModel(Protocol):
    """What is believed of objects that have not shown themselves yet."""

    def on(self, dictionary: Dictionary, region: Region, model: Model, step_s: float) -> Undetected | None:
        """What carries that belief in a region; None for nothing."""
        ...

    def num_hypotheses(self, region: Region, model: Model, step_s: float) -> int:
        """Numbers that it carries for each sequence there."""
        ...


@dataclass(frozen=True)
class Ignored(Checked):
    """Nothing: a new object shows itself in one step or is forgotten, as in Liang and Meyer."""

    KEY: ClassVar[str] = "tracker.undetected"

    def on(self, dictionary: Dictionary, region: Region, model: Model, step_s: float) -> Undetected | None:
        """See `UndetectedModel.on`."""
        return None

    def num_hypotheses(self, region: Region, model: Model, step_s: float) -> int:
        """None."""
        return 0


UNKNOWN = 0.1
"""Share of an object's power that is not where a field says, where no share of mismatch is known."""


@dataclass(frozen=True)
class Intensity(Checked):
    """Settings of the intensity of undetected objects.

    Attributes:
        levels: number L of levels of power.
        lowest, highest: of the levels, ratio of signal to noise of one tone and snapshot behind the array:
            what a hundred steps can show, and what shows itself in one.
        step_nats: most that one step can add to the logarithm of the intensity: what says more is seen
            without it, or is nothing that the model explains.
        leftover: share of the power of known objects that their responses may leave unexplained: errors of
            phase of 18 degrees, echoes. So much counts as noise here. None: nothing where a share of mismatch
            (`TrackerConfig.mismatch_share`, or that of the calibration) says it, and `UNKNOWN` elsewhere.
        promote: existence probability above which a neighbourhood becomes a potential object.
        alike: share of a response's energy that another explains, from which on both are one neighbourhood.
        hypotheses: number of cells times levels times rates, at most; a region whose cells and levels alone
            are more is too large.
    """

    KEY: ClassVar[str] = "tracker.undetected"

    levels: Count = 5
    lowest: Positive = 0.1
    highest: Positive = 10.0
    step_nats: Nats = 10.0
    leftover: Share | None = 0.1
    promote: InnerProbability = 0.2
    alike: InnerProbability = 0.5
    hypotheses: Annotated[int, Range("a positive integer", low=1, most=1e9, whole=True)] = 1_000_000

    def unexplained(self, field: BaseField, state: Tensor) -> float:
        """`leftover` of a field, which is asked at any state."""
        if self.leftover is not None:
            return self.leftover
        return UNKNOWN if field.diffuse(of_each(field, state)) is None else 0.0

    def level(self, like: Tensor) -> Tensor:
        """The levels, `(L,)`, evenly spaced in the logarithm."""
        ratio = self.highest / self.lowest
        along = torch.linspace(0, 1, self.levels, dtype=like.dtype, device=like.device)
        return self.lowest * ratio**along

    @property
    def step(self) -> float:
        """Ratio of a level to the one below."""
        return float((self.highest / self.lowest) ** (1 / max(1, self.levels - 1)))

    def tone_levels(self, level: Tensor) -> tuple[Tensor, Tensor]:
        """Levels of tones, `(G,)`, and their shares `(L, 1 + G)`, the first of silent ones."""
        num = len(level)
        around = torch.cat([level[:1] / self.step, level, level[-1:] * self.step])
        share = level.new_zeros(num, 1 + len(around))
        row = torch.arange(num, device=level.device)
        for weight, move in AROUND:
            column = torch.zeros_like(row) if move is None else row + 2 + move
            share[row, column] = weight
        return around, share

    def on(self, dictionary: Dictionary, region: Region, model: Model, step_s: float) -> Undetected | None:
        """See `UndetectedModel.on`; None, with a warning, where the region is too large."""
        if not self._fits(region):
            log.warning(
                "the region's %d cells at %d levels are more than tracker.undetected.hypotheses=%d: "
                "sources that are too weak to show themselves in one step will not be found",
                math.prod(region.grid_shape),
                self.levels,
                self.hypotheses,
            )
            return None
        return Undetected.of(self, dictionary, region, model, step_s)

    def num_hypotheses(self, region: Region, model: Model, step_s: float) -> int:
        """See `UndetectedModel.num_hypotheses`; none where the region is too large."""
        if not self._fits(region):
            return 0
        grid = lay_grid(region, model.motion, step_s, self.level(region.low), self.hypotheses)
        return len(grid.node) * self.levels * region.num_cells

    def _fits(self, region: Region) -> bool:
        return math.prod(region.grid_shape) * self.levels <= self.hypotheses
