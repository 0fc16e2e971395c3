"""The check of all settings, and that none of them goes without."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Annotated, Any

import pytest

from torchdt.core.errors import InputError
from torchdt.core.ranges import (
    FINITE,
    Checked,
    Count,
    Decibels,
    Each,
    Finite,
    InnerProbability,
    Name,
    OneOf,
    Positive,
    PositiveShare,
    check,
)


@dataclass
class Settings(Checked):
    KEY = "group"

    count: Count = 1
    length: Positive | None = None
    chance: InnerProbability = 0.5
    part: PositiveShare = 1.0
    level: Decibels = 0.0
    pairs: list[list[Count]] = field(default_factory=list)
    places: list[Annotated[Any, Each(FINITE)]] = field(default_factory=list)
    by_name: dict[str, Finite] = field(default_factory=dict)
    kind: Annotated[str, OneOf(("a", "b", "d"))] = "a"
    name: Name = "x"
    shown: bool = True
    title: str = ""


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("count", (1, 10**6)),
        ("length", (None, 1e-30, 3, 1e18)),
        ("chance", (1e-9, 0.999)),
        ("part", (1, 1e-3)),
        ("level", (-1000, 1000)),
        ("pairs", ([], [[1, 2], [3]])),
        ("places", ([], [[1, -2.5], []])),
        ("by_name", ({}, {"a": -1e18})),
        ("name", ("close_6db", "v1.2-b", "Ärmel", "x" * 100)),
    ],
)
def test_what_is_in_range(name, values):
    for value in values:
        assert getattr(Settings(**{name: value}), name) == value


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *(("count", value, "a positive integer") for value in (0, -1, 2.0, True, math.nan, "1", None)),
        ("count", 10**400, "a positive integer, at most 1e+06"),
        *(
            ("length", value, "a positive number or null")
            for value in (0, -1.0, math.inf, math.nan, "a", False)
        ),
        ("length", 1e-31, "a positive number, at least 1e-30 or null"),
        *(("chance", value, "a probability strictly between 0 and 1") for value in (0, 1, 1.0, math.nan)),
        *(("part", value, "a number above 0, up to 1") for value in (0, 1.001)),
        ("level", 1001, "a finite number, at most 1000"),
        ("level", -1001, "a finite number, at least -1000"),
        ("pairs", [[1], [0]], "a list, each entry a list, each entry a positive integer"),
        ("pairs", [1], "a list, each entry a list"),
        ("pairs", 3, "a list"),
        ("places", [[1, math.nan]], "a list, each entry a list, each entry a finite number"),
        ("by_name", {"a": "b"}, "values by name, each a finite number"),
        ("by_name", [1.0], "values by name"),
        ("kind", "c", "a, b or d"),
        *(
            ("name", value, "letters, digits, '_' and '-', and '.' inside")
            for value in ("", ".", "..", "../../x", "a/b", "a\\b", "a b", "a\n", ".x", "x.", "\0", "x" * 101)
        ),
        ("shown", 1, "true or false"),
        ("title", 1, "a text"),
    ],
)
def test_what_is_not(name, value, expected):
    with pytest.raises(InputError) as caught:
        Settings(**{name: value})
    assert str(caught.value) == f"key 'group.{name}': found {value}, expected {expected}"


def test_settings_without_a_key_of_their_own():
    settings = Settings()
    settings.count = 0
    with pytest.raises(InputError, match="key 'count': found 0"):
        check(settings)


def test_subclasses_are_checked_whole():
    @dataclass
    class More(Settings):
        more: Count = 1

    assert [f.name for f in dataclasses.fields(More)][-1] == "more"
    for name in ("count", "more"):
        with pytest.raises(InputError, match=f"group.{name}"):
            More(**{name: -1})
