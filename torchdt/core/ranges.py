"""What a setting may be, said in its type: `slots: Count = 16`, and the one check of all of them.

Besides what makes sense at all, ranges keep to what can be computed: numbers whose squares single precision
holds, and counts that do not take a machine's memory or a lifetime.
"""

import functools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin, get_type_hints

from torchdt.core.errors import InputError

TINY, HUGE = 1e-30, 1e18
"""Smallest and largest magnitude of numbers that no other range limits."""


@dataclass(frozen=True)
class Range:
    """Finite numbers between two limits.

    Attributes:
        words: what is in range, for messages.
        low, high: limits of what makes sense, themselves inside unless open.
        open_low, open_high: whether a limit is outside.
        least, most: limits of what can be computed.
        whole: integers alone.
    """

    words: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    least: float = -HUGE
    most: float = HUGE
    whole: bool = False

    def fault(self, value: object) -> str | None:
        """What was expected in place of a value; None where it is in range."""
        if isinstance(value, bool) or not isinstance(value, int if self.whole else int | float):
            return self.words
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        if not (above and below) or abs(value) == math.inf:
            return self.words
        if value > self.most:
            return f"{self.words}, at most {self.most:g}"
        return f"{self.words}, at least {self.least:g}" if value < self.least else None


@dataclass(frozen=True)
class OneOf:
    """One of some texts."""

    choices: tuple[str, ...]

    def fault(self, value: object) -> str | None:
        """What was expected in place of a value; None where it is one of them."""
        *first, last = self.choices
        return None if value in self.choices else " or ".join([", ".join(first), last] if first else [last])


@dataclass(frozen=True)
class Matching:
    """Texts of a pattern, which `words` describe."""

    words: str
    pattern: str

    def fault(self, value: object) -> str | None:
        """What was expected in place of a value; None where it is such a text."""
        fits = isinstance(value, str) and re.fullmatch(self.pattern, value)
        return None if fits else self.words


@dataclass(frozen=True)
class Each:
    """Lists of such numbers, for types that cannot say so: Hydra has no lists of lists of floats."""

    range: Range

    def fault(self, value: object) -> str | None:
        """What was expected in place of a value; None where it is such a list."""
        return fault(list[Annotated[Any, self.range]], value)


Count = Annotated[int, Range("a positive integer", low=1, most=1e6, whole=True)]
"""How many there are of what takes memory."""
Passes = Annotated[int, Range("a positive integer", low=1, most=1e4, whole=True)]
"""How often something is done again at most."""
Steps = Annotated[int, Range("a positive integer", low=1, most=1e7, whole=True)]
"""Length of a sequence, or of a part of it."""
Threads = Annotated[int, Range("a positive integer", low=1, most=4096, whole=True)]
StepIndex = Annotated[int, Range("a step from 0 up", low=0, most=1e9, whole=True)]
Seed = Annotated[int, Range("an integer", least=-(2.0**62), most=2.0**62, whole=True)]
FINITE = Range("a finite number")
Finite = Annotated[float, FINITE]
Positive = Annotated[float, Range("a positive number", low=0, open_low=True, least=TINY)]
BirthMean = Annotated[float, Range("a positive number", low=0, open_low=True, least=TINY, most=1e4)]
"""Mean number of objects or points that a step brings."""
NotNegative = Annotated[float, Range("a number from 0 up", low=0)]
Probability = Annotated[float, Range("a probability", low=0, high=1)]
InnerProbability = Annotated[
    float, Range("a probability strictly between 0 and 1", 0, 1, open_low=True, open_high=True)
]
Share = Annotated[float, Range("a number from 0 to 1", low=0, high=1)]
PositiveShare = Annotated[float, Range("a number above 0, up to 1", low=0, high=1, open_low=True)]
Nats = Annotated[float, Range("a number from 0 up", low=0, most=1e6)]
Decibels = Annotated[float, Range("a finite number", least=-1000, most=1000)]
Power = Annotated[float, Range("a positive number", low=0, open_low=True, least=1e-100, most=1e100)]
"""In squared data units, whatever these are."""
Name = Annotated[str, Matching("letters, digits, '_' and '-', and '.' inside", r"[\w-]([\w.-]{0,98}[\w-])?")]
"""Part of the name of a folder."""


class Checked:
    """Settings whose types say what they may be: a mixin of dataclasses.

    Attributes:
        KEY: of the settings as a whole in the configuration, for messages.
    """

    KEY: ClassVar[str] = ""

    def __post_init__(self) -> None:
        """Check each field by its type.

        Raises:
            InputError: naming the first that does not fit.
        """
        check(self, self.KEY)


def check(settings: object, key: str = "") -> None:
    """Check each field of a dataclass by its type, see `Checked`."""
    kind: Any = type(settings)
    for name, hint in hints(kind).items():
        value = getattr(settings, name)
        expected = fault(hint, value)
        if expected is not None:
            raise InputError.of_key(f"{key}.{name}" if key else name, value, expected)


@functools.cache
def hints(kind: type) -> Mapping[str, Any]:
    """Types of a dataclass's fields by name, with what is said about them."""
    found = get_type_hints(kind, include_extras=True)
    return {name: hint for name, hint in found.items() if get_origin(hint) is not ClassVar}


def fault(hint: Any, value: object) -> str | None:
    """What was expected in place of a value; None where a type allows it.

    Types that say nothing are not looked into, such as those of settings within settings.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        found = (rule.fault(value) for rule in hint.__metadata__)
        return fault(arguments[0], value) or next(filter(None, found), None)
    if origin in (Union, UnionType):
        if value is None and NoneType in arguments:
            return None
        faults = [fault(argument, value) for argument in arguments if argument is not NoneType]
        return None if None in faults else " or ".join([*filter(None, faults), "null"])
    if origin is list:
        if not isinstance(value, list | tuple):
            return "a list"
        return _first(arguments[0], value, "a list, each entry ")
    if origin is dict:
        if not isinstance(value, dict):
            return "values by name"
        return _first(arguments[1], value.values(), "values by name, each ")
    if hint is bool and not isinstance(value, bool):
        return "true or false"
    return "a text" if hint is str and not isinstance(value, str) else None


def _first(hint: Any, values: Any, words: str) -> str | None:
    expected = next((found for value in values if (found := fault(hint, value))), None)
    return None if expected is None else words + expected
