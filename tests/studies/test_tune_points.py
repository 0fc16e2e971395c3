import csv
from dataclasses import replace

import pytest
import torch
import yaml
from hydra import compose
from oracles.line_array import make_region
from oracles.scripts import call, configuration, load

from studies.tune_points import (
    TunePointsSettings,
    decode,
    detect,
    encode,
    evaluate,
    two_step,
)
from torchdt.app.settings import settings_of
from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.two_step import TwoStepConfig
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow

REGION = make_region()
CONFIG = TwoStepConfig(
    detection_probability=0.8,
    clutter_mean=0.2,
    birth_mean=0.03,
    spread={"bearing": 0.4},
    detector=PursuitConfig(threshold=9),
)


@pytest.fixture(scope="module")
def search(tmp_path_factory):
    """Run `experiments/tune_points.py` in a small size; directory, exit status, error output."""

    def run(*overrides: str):
        directory = tmp_path_factory.mktemp("search", numbered=True)
        small = ["suite=[line_array]", "evaluations=5", "seed=3", f"hydra.run.dir={directory}"]
        sizes = 'overrides=["scenario.num_steps=12","tracker.particles=100","tracker.slots=4"]'
        status, _, err = call(load("tune_points"), *small, sizes, *overrides)
        return directory, status, err

    return run


def test_values_there_and_back():
    again = decode(encode(CONFIG, REGION), TwoStepConfig(), REGION)
    for name in ("detection_probability", "clutter_mean", "birth_mean", "spread"):
        assert getattr(again, name) == pytest.approx(getattr(CONFIG, name))
    assert again.detector.threshold == pytest.approx(9)
    assert isinstance(again.detector, PursuitConfig)


def test_a_factor_of_e_for_each_unit_and_less_for_the_threshold():
    moved = decode(encode(CONFIG, REGION) + torch.tensor([0.0, 1.0, 0.0, 3.0, -1.0]), CONFIG, REGION)
    assert moved.clutter_mean == pytest.approx(0.2 * 2.718282)
    assert moved.spread == {"bearing": pytest.approx(0.4 / 2.718282)}
    assert moved.detector.threshold == pytest.approx(9 * 2.718282)
    assert moved.detection_probability == pytest.approx(0.8)


@pytest.mark.parametrize("tracker", ["mp_bp", "sbl_bp"])
def test_the_best_settings_are_those_of_the_table(search, tracker):
    directory, status, err = search(f"method={tracker}")
    assert status == 0, err
    with (directory / "search.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["evaluation"] for row in rows] == ["0", "1", "2", "3", "4"]
    assert all(row["gospa"] == row["line_array"] for row in rows)
    best = min(rows, key=lambda row: float(row["gospa"]))
    tuned = yaml.safe_load((directory / "tuned.yaml").read_text())
    for name in ("detection_probability", "clutter_mean", "birth_mean"):
        assert tuned[name] == pytest.approx(float(best[name]))
    assert tuned["spread"]["bearing"] == pytest.approx(float(best["spread.bearing"]))
    assert tuned["detector"]["threshold"] == pytest.approx(float(best["detector.threshold"]))


def test_the_first_evaluation_is_the_configured_tracker(search, tmp_path):
    """Points that are detected once and tracked in a batch score what `track.py` scores."""
    sizes = ["scenario=line_array", "scenario.num_steps=12", "tracker=mp_bp"]
    sizes += ["tracker.particles=100", "tracker.slots=4", "seed=3", "tracker.detector.threshold=5"]
    status, _, err = call(load("track"), *sizes, "logging=quiet", f"hydra.run.dir={tmp_path}")
    assert status == 0, err
    # Searched over no range to speak of, the points are those of the configured threshold.
    fixed = '"scenario.num_steps=12","tracker.particles=100","tracker.slots=4","tracker.detector.threshold=5"'
    directory, _, _ = search(f"overrides=[{fixed}]", "evaluations=1", "width=1e-6")
    with (directory / "search.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    with (tmp_path / "gospa.csv").open(newline="") as file:
        scores = [float(r["gospa"]) for r in csv.DictReader(file)]
    assert float(row["gospa"]) == pytest.approx(sum(scores) / len(scores), abs=1e-3)


def test_only_two_step_trackers(search):
    _, status, err = search("method=direct")
    assert status == 1
    assert "two-step tracker" in err


@pytest.mark.parametrize(("key", "value"), [("suite", []), ("runs", 0), ("evaluations", 0), ("width", 0.0)])
def test_settings_out_of_range(key, value):
    with pytest.raises(InputError, match=rf"key '{key}'"):
        TunePointsSettings(**({"suite": ["line_array"]} | {key: value}))


def test_scenarios_that_do_not_fit_in_one_batch(search):
    few = 'overrides=["tracker.particles=100","tracker.slots=4"]'
    _, status, err = search("suite=[line_array,line_array_model]", few, "evaluations=1")
    assert status == 0, err
    _, status, err = search(
        "suite=[line_array,empty]", 'overrides=["scenario.num_steps=2","calibration=none"]'
    )
    assert status == 1
    assert "key 'suite'" in err


def test_tuned_values_fit_the_configuration_of_the_tracker():
    with configuration():
        for tracker in ("mp_bp", "sbl_bp"):
            settings = settings_of(compose("track", overrides=[f"tracker={tracker}"]))
            assert isinstance(settings.tracker, TwoStepConfig)
            assert settings.tracker.birth_mean / settings.tracker.clutter_mean > settings.tracker.prune


def test_points_below_the_threshold_that_is_tried_are_not_tracked():
    sizes = [
        "scenario.num_steps=8",
        "tracker.particles=100",
        "tracker.slots=4",
        "tracker.detector.threshold=5",
    ]
    settings = TunePointsSettings(suite=["line_array"], overrides=sizes)
    with configuration():
        part = detect("line_array", settings)
    assert part.points.present.any()
    config = two_step(part.settings)
    deaf = replace(config, detector=replace(config.detector, threshold=1e6))
    truth = part.recording.truth_mask
    assert evaluate([part], deaf, settings) == pytest.approx([5.0 * float(truth.sum(-1).double().mean())])
    assert evaluate([part], config, settings)[0] < 0.8 * evaluate([part], deaf, settings)[0]
