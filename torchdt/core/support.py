"""Where a number of the model may lie, and how the real line is mapped onto that."""

import math
from typing import NamedTuple

from torch import Tensor
from torch.distributions import biject_to, constraints

from torchdt.core.ranges import TINY, Range


class Support(NamedTuple):
    """Interval of a number.

    Attributes:
        range: what the number may be; where its ends are closed, it may be held there but not learned.
        constraint: whose bijection from the real line makes the number of its unconstrained value.
    """

    range: Range
    constraint: constraints.Constraint

    @property
    def words(self) -> str:
        """What a number that is learned must be."""
        low, high, words = self.range.low, self.range.high, self.range.words
        closed = [f"{low:g}"] * (low > -math.inf and not self.range.open_low)
        closed += [f"{high:g}"] * (high < math.inf and not self.range.open_high)
        return f"{words}, not {' or '.join(closed)} to be learned" if closed else words

    def inside(self, value: Tensor) -> bool:
        """Whether all entries may be learned: strictly between the ends."""
        return bool(((self.range.low < value) & (value < self.range.high)).all())

    def constrain(self, unconstrained: Tensor) -> Tensor:
        """Numbers of unconstrained values."""
        return biject_to(self.constraint)(unconstrained)

    def unconstrain(self, value: Tensor) -> Tensor:
        """Unconstrained values of numbers strictly between the ends."""
        return biject_to(self.constraint).inv(value)


REAL = Support(Range("a finite number"), constraints.real)
POSITIVE = Support(Range("a positive number", low=0, open_low=True, least=TINY), constraints.positive)
UNIT = Support(
    Range("a probability strictly between 0 and 1", 0, 1, open_low=True, open_high=True),
    constraints.unit_interval,
)
UP_TO_ONE = Support(Range("a number above 0, up to 1", 0, 1, open_low=True), constraints.unit_interval)


class Quantity(NamedTuple):
    """A number, or a vector of them, that a likelihood can be differentiated in.

    Attributes:
        support: where it lies.
        value: what the model uses unless told otherwise; None where it has none.
        vector: whether it is one number for each coordinate, tone or the like.
    """

    support: Support
    value: Tensor | float | None = None
    vector: bool = False
