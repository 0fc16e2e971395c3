import math

import pytest

from torchdt.config import TrackerConfig
from torchdt.errors import InputError
from torchdt.scenario.settings import (
    CoordinateSettings,
    MismatchSettings,
    PathSettings,
    ScenarioSettings,
    SourceSettings,
)


def refuse(make, key: str, found: object, expected: str) -> None:
    """The message names the key, what was found and what would have been right."""
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value) == f"key '{key}': found {found}, expected {expected}"


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("num_steps", 0, "a positive integer"),
        ("num_snapshots", 0, "a positive integer"),
        ("step_s", 0.0, "a positive number"),
        ("step_s", math.inf, "a positive number"),
        ("step_s", math.nan, "a positive number"),
        ("snr_db", math.nan, "a finite number"),
        ("snr_db", math.inf, "a finite number"),
        ("gospa_cutoff", 0.0, "a positive number"),
        ("gospa_order", 0.5, "a number from 1 up"),
        ("phase_step_deg", -1.0, "a number from 0 up"),
        ("coordinates", [], "at least one coordinate"),
        ("amplitudes", "loud", "gaussian or constant_modulus"),
    ],
)
def test_scenario(name, value, expected):
    refuse(lambda: ScenarioSettings(**{name: value}), f"scenario.{name}", value, expected)


@pytest.mark.parametrize(
    ("times", "positions", "key", "expected"),
    [
        ([0.0, 1.0], [[0.0]], "positions", "2 positions, one for each time"),
        ([], [], "positions", "0 positions, one for each time"),
        ([0.0, 0.0], [[0.0], [1.0]], "times_s", "increasing times"),
        ([1.0, 0.0], [[0.0], [1.0]], "times_s", "increasing times"),
        ([0.0, math.nan], [[0.0], [1.0]], "times_s", "increasing times"),
    ],
)
def test_paths(times, positions, key, expected):
    found = positions if key == "positions" else times
    refuse(lambda: PathSettings(times, positions), f"scenario.paths.{key}", found, expected)


def test_positions_have_the_coordinates_of_the_region():
    paths = {"there": PathSettings([0.0], [[1.0, 2.0]])}
    refuse(
        lambda: ScenarioSettings(paths=paths),
        "scenario.paths.there.positions",
        [[1.0, 2.0]],
        "1 coordinates each",
    )
    two = [CoordinateSettings(), CoordinateSettings("depth")]
    assert ScenarioSettings(paths=paths, coordinates=two).paths == paths


@pytest.mark.parametrize(
    ("settings", "key", "found", "expected"),
    [
        ({"birth": -1}, "birth", -1, "a step from 0 up"),
        ({"birth": 5, "death": 5}, "death", 5, "a step after birth 5, or null"),
        ({"silences": [[3]]}, "silences", [[3]], "pairs [first, last]"),
        ({"silences": [[3, 2]]}, "silences", [[3, 2]], "pairs [first, last]"),
        ({"silences": [[1, 2], [-1, 2]]}, "silences", [[1, 2], [-1, 2]], "pairs [first, last]"),
    ],
)
def test_sources(settings, key, found, expected):
    refuse(lambda: SourceSettings("p", **settings), f"scenario.sources.{key}", found, expected)


def test_a_source_needs_a_known_path():
    paths = {"east": PathSettings(), "west": PathSettings()}
    refuse(
        lambda: ScenarioSettings(paths=paths, sources={"a": SourceSettings("north")}),
        "scenario.sources.a.path",
        "north",
        "one of ['east', 'west']",
    )


@pytest.mark.parametrize(
    ("settings", "key", "found", "expected"),
    [
        ({"eof_scale": -1.0}, "eof_scale", -1.0, "a number from 0 up"),
        ({"tilt_deg": [2.0, 1.0]}, "tilt_deg", [2.0, 1.0], "[smallest, largest], both from 0 up"),
        ({"water_depth_m": [1.0]}, "water_depth_m", [1.0], "[smallest, largest], both from 0 up"),
        ({"tilt_deg": [-1.0, 1.0]}, "tilt_deg", [-1.0, 1.0], "[smallest, largest], both from 0 up"),
    ],
)
def test_mismatch(settings, key, found, expected):
    refuse(lambda: MismatchSettings(**settings), f"scenario.mismatch.{key}", found, expected)


@pytest.mark.parametrize(
    ("settings", "matched"),
    [
        ({}, True),
        ({"eof_scale": 1.0}, False),
        ({"tilt_deg": [0.0, 1.0]}, False),
        ({"water_depth_m": [0.0, 1.0]}, False),
    ],
)
def test_whether_environments_match(settings, matched):
    assert MismatchSettings(**settings).matched == matched


COUNTS = ("slots", "particles", "power_points", "noise_points", "births", "sweeps", "rounds", "round_size")


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *((name, 0, "a positive integer") for name in COUNTS),
        *((name, 0.0, "a positive number") for name in ("power_shape", "noise_shape", "birth_mean")),
        *((name, math.inf, "a positive number") for name in ("power_shape", "noise_shape", "birth_mean")),
        *((name, 0.0, "a positive number or null") for name in ("power_max", "noise_max")),
        *((name, 1.0, "a probability strictly between 0 and 1") for name in ("survival", "declare", "prune")),
        *((name, 1.5, "a number from 0 to 1") for name in ("roughening", "resample_below")),
        ("likelihood_power", 0.0, "a number above 0, up to 1"),
        ("likelihood_power", 1.1, "a number above 0, up to 1"),
        ("schedule", "random", "sequential or flooding"),
        ("proposal", "random", "adapted or prior"),
    ],
)
def test_tracker(name, value, expected):
    refuse(lambda: TrackerConfig(**{name: value}), f"tracker.{name}", value, expected)
