import math
from dataclasses import replace

import pytest
from hydra import compose, initialize_config_module

from torchdt.app.settings import settings_of
from torchdt.core.errors import InputError
from torchdt.filter.config import TrackerConfig
from torchdt.model.distance import Euclidean, GreatCircle
from torchdt.simulation.settings import (
    CoordinateSettings,
    InterfererSettings,
    PathSettings,
    PopulationSettings,
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
        ("gospa_order", 1e30, "a number from 1 up, at most 100"),
        ("gospa_order", 50.0, "an order whose power of the cutoff, 200, is no overflow"),
        ("step_s", 1e300, "a positive number, at most 1e+09"),
        ("name", "../../x", "letters, digits, '_' and '-', and '.' inside"),
        ("name", "a/b", "letters, digits, '_' and '-', and '.' inside"),
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
        ([0.0, math.nan], [[0.0], [1.0]], "times_s", "a list, each entry a finite number"),
        ([0.0], [[math.inf]], "positions", "a list, each entry a list, each entry a finite number"),
        ([0.0], [0.0], "positions", "a list, each entry a list"),
    ],
)
def test_paths(times, positions, key, expected):
    found = positions if key == "positions" else times
    refuse(lambda: PathSettings(times, positions), f"scenario.paths.{key}", found, expected)


@pytest.mark.parametrize(
    ("changes", "key", "found", "expected"),
    [
        (
            {"gospa_scale": [1.0, 2.0]},
            "gospa_scale",
            [1.0, 2.0],
            "1 numbers, as the coordinates, or null",
        ),
        ({"gospa_scale": [0.0]}, "gospa_scale", [0.0], "a list, each entry a positive number or null"),
        ({"gospa_distance": "taxi"}, "gospa_distance", "taxi", "euclidean or great_circle"),
        (
            {"gospa_distance": "great_circle"},
            "gospa_distance",
            "great_circle of coordinates in m",
            "euclidean, or coordinates azimuth, or azimuth and elevation, in deg",
        ),
        (
            {
                "gospa_distance": "great_circle",
                "gospa_scale": [2.0],
                "coordinates": [CoordinateSettings("azimuth", "deg")],
            },
            "gospa_scale",
            [2.0],
            "null beside a great circle, which has degrees",
        ),
    ],
)
def test_distances_that_do_not_fit(changes, key, found, expected):
    refuse(lambda: ScenarioSettings(**changes), f"scenario.{key}", found, expected)


def test_distance_of_a_scenario():
    """Periods are those of the coordinates."""
    azimuth = CoordinateSettings("azimuth", "deg", -180, 180, 5, period=360)
    scenario = ScenarioSettings(coordinates=[azimuth, CoordinateSettings("range")])
    assert (scenario.distance, scenario.distance_unit) == (Euclidean(None, (360, None)), "deg")
    scaled = replace(scenario, gospa_scale=[5.0, 100.0])
    assert (scaled.distance, scaled.distance_unit) == (Euclidean((5.0, 100.0), (360, None)), "")
    sky = ScenarioSettings(coordinates=[azimuth], gospa_distance="great_circle")
    assert (sky.distance, sky.distance_unit) == (GreatCircle(), "deg")


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
        *(
            ({"silences": pairs}, "silences", pairs, "a list, each entry a list, each entry a step from 0 up")
            for pairs in ([[1, 2], [-1, 2]], [[0.5, 1.5]], [["a", "b"]])
        ),
        ({"power_db": 1e4}, "power_db", 1e4, "a finite number, at most 1000"),
    ],
)
def test_sources(settings, key, found, expected):
    refuse(lambda: SourceSettings("p", **settings), f"scenario.sources.{key}", found, expected)


@pytest.mark.parametrize(("key", "kind"), [("sources", SourceSettings), ("interferers", InterfererSettings)])
def test_a_source_needs_a_known_path(key, kind):
    paths = {"east": PathSettings(), "west": PathSettings()}
    refuse(
        lambda: ScenarioSettings(paths=paths, **{key: {"a": kind("north")}}),
        f"scenario.{key}.a.path",
        "north",
        "one of ['east', 'west']",
    )


def test_messages_of_interferers_name_their_own_key():
    for settings, key, found, expected in (
        ({"death": 0}, "death", 0, "a step after birth 0, or null"),
        ({"silences": [[3]]}, "silences", [[3]], "pairs [first, last]"),
    ):
        refuse(
            lambda settings=settings: InterfererSettings("p", **settings),
            f"scenario.interferers.{key}",
            found,
            expected,
        )


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("birth_mean", -0.1, "a number from 0 up"),
        ("birth_mean", math.inf, "a number from 0 up"),
        ("survival", 1.5, "a probability"),
        ("survival", math.nan, "a probability"),
        *((name, 0.0, "a positive number") for name in ("power_shape", "noise_shape")),
        *((name, math.inf, "a positive number") for name in ("power_shape", "noise_shape")),
        *(
            ("power_db", value, "[lowest, highest]" if finite else "a list, each entry a finite number")
            for value, finite in (
                ([1.0], True),
                ([3.0, -3.0], True),
                ([-math.inf, 0.0], False),
                (["a", "b"], False),
            )
        ),
        ("max_objects", 0, "a positive integer or null"),
    ],
)
def test_population(name, value, expected):
    refuse(lambda: PopulationSettings(**{name: value}), f"scenario.population.{name}", value, expected)


def test_either_a_population_or_sources():
    paths, sources = {"p": PathSettings()}, {"b": SourceSettings("p"), "a": SourceSettings("p")}
    refuse(
        lambda: ScenarioSettings(paths=paths, sources=sources, population=PopulationSettings()),
        "scenario.sources",
        ["a", "b"],
        "none beside scenario.population",
    )
    assert ScenarioSettings(population=PopulationSettings()).sources == {}


def test_a_scenario_file_may_hold_a_population():
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        composed = compose(
            "track", overrides=["scenario=line_array_model", "scenario.population.survival=0.9"]
        )
        plain = compose("track", overrides=["scenario=line_array_model", "scenario.population=null"])
    population = settings_of(composed).scenario.population
    assert population == PopulationSettings(0.05, 0.9, 50.0, 20.0, [-3.0, 3.0], 4)
    assert settings_of(plain).scenario.population is None


COUNTS = ("slots", "particles", "power_points", "noise_points", "births", "sweeps")


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        *((name, 0, "a positive integer") for name in COUNTS),
        *((name, 0.0, "a positive number or null") for name in ("power_max", "noise_max")),
        *((name, 1.0, "a probability strictly between 0 and 1") for name in ("declare", "prune")),
    ],
)
def test_tracker(name, value, expected):
    refuse(lambda: TrackerConfig(**{name: value}), f"tracker.{name}", value, expected)
