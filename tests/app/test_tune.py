import csv
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import pytest
import torch
import yaml
from hydra import compose
from oracles.scripts import SMALL, call, configuration, load
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchdt.app.build import simulate
from torchdt.app.settings import settings_of
from torchdt.app.targets import build_model
from torchdt.core.errors import InputError
from torchdt.data.npz import write_npz
from torchdt.model.model import Model
from torchdt.tuning.tracker import TrackerObjective

pytestmark = pytest.mark.slow
SCRIPT = load("tune")  # it registers the schema of its configuration
# Support points as in tracking, so that the two can be compared.
POINTS = ("tracker.power_points=16", "tracker.noise_points=64")
LINE = ("scenario=line_array", *SMALL, *POINTS, "train_seeds=[0,1]", "heldout_seeds=[7]")
SHORT = ("tuning.steps=4", "tuning.heldout_every=2", "tuning.gospa_every=2", "tuning.slice_points=2")
NAMES = ("power_shape", "noise_shape", "survival", "birth_mean")


@dataclass
class Outcome:
    directory: Path
    status: int
    out: str
    err: str

    def rows(self):
        with (self.directory / "tuning.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    def json(self, name="tuning.json"):
        return json.loads((self.directory / name).read_text())

    def tuned(self):
        return yaml.safe_load((self.directory / "tuned.yaml").read_text())

    def events(self):
        return EventAccumulator(str(self.directory / "tensorboard"), size_guidance={"scalars": 0}).Reload()


def tune(directory, *overrides, small=True):
    size = (*LINE, *SHORT) if small else ()
    overrides = (*size, f"hydra.run.dir={directory}", *overrides)
    return Outcome(directory, *call(SCRIPT, *overrides))


def fails(outcome, *words):
    assert outcome.status == 1
    for word in words:
        assert word in outcome.err
    kept = {path.name for path in outcome.directory.iterdir()}
    assert kept <= {".hydra", "tune.log"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return tune(tmp_path_factory.mktemp("tune"))


@pytest.fixture(scope="module")
def events(run):
    return run.events()


def test_files(run):
    assert run.status == 0, run.err
    found = {path.name for path in run.directory.iterdir()}
    assert found == {
        ".hydra",
        "tune.log",
        "checkpoint.pt",
        "figures",
        "manifest.json",
        "tensorboard",
        "tuned.yaml",
        "tuning.csv",
        "tuning.json",
    }
    assert {path.stem for path in (run.directory / "figures").iterdir()} == {f"slice_{n}" for n in NAMES}
    assert run.json("manifest.json")["config"]["train_seeds"] == [0, 1]
    assert f"--config-dir={run.directory} --config-name=tuned" in (run.directory / "tune.log").read_text()


def test_table(run):
    rows = run.rows()
    header = ["step", "objective", "heldout", "skipped", "passes", *NAMES]
    assert list(rows[0]) == [*header, *(f"gradient_{name}" for name in NAMES)]
    assert [row["passes"] for row in rows] == ["4", "7", "11", "14", "16"]
    assert [row["heldout"] != "" for row in rows] == [True, False, True, False, True]
    assert all(float(row["gradient_survival"]) > 0 for row in rows[:-1])
    assert float(rows[-1]["objective"]) > float(rows[0]["objective"])


def test_summary(run):
    summary, rows = run.json(), run.rows()
    assert (summary["method"], summary["steps"], summary["passes"], summary["skipped"]) == (
        "gradient",
        5,
        16,
        0,
    )
    best = max((row for row in rows if row["heldout"]), key=lambda row: float(row["heldout"]))
    assert summary["best_step"] == int(best["step"])
    assert summary["heldout"] == {"before": float(rows[0]["heldout"]), "after": float(best["heldout"])}
    for name in NAMES:
        assert summary["start"][name] == float(rows[0][name])
        assert summary["best"][name] == pytest.approx(float(best[name]))
    assert summary["start"]["survival"] == pytest.approx(0.95)
    assert all(0 < summary["heldout_gospa"][key] < 10 for key in ("before", "after"))


def test_heldout_value_is_that_of_tracking(run, launch, settings):
    """Per step, at the values of the configuration, in units of the scaled data."""
    s = settings("seed=7")
    tracked = launch("seed=7").json("metrics.json")
    recording = simulate(s)
    scale = recording.snapshots.abs().square().mean().sqrt()
    shifted = tracked["log_likelihood"] + 2 * recording.snapshots.numel() * scale.log()
    assert run.json()["heldout"]["before"] * 5 == pytest.approx(float(shifted), rel=1e-4)
    assert run.json()["heldout_gospa"]["before"] == pytest.approx(tracked["gospa"]["mean"], rel=1e-4)


def test_events(run, events):
    tags = events.Tags()
    expected = {f"tuning/{name}" for name in ("objective", "heldout", "passes", "skipped")}
    expected |= {f"{kind}/{name}" for kind in ("value", "gradient_norm") for name in NAMES}
    expected |= {"heldout_gospa/total", "hparam/heldout", "hparam/heldout_gospa"}
    assert set(tags["scalars"]) == expected
    assert set(tags["images"]) == {f"slices/{name}" for name in NAMES}
    rows = run.rows()
    written = [(event.step, event.value) for event in events.Scalars("value/birth_mean")]
    assert written == [(int(row["step"]), pytest.approx(float(row["birth_mean"]))) for row in rows]
    heldout = [event.step for event in events.Scalars("tuning/heldout")]
    assert heldout == [0, 2, 4]
    assert {event.step for event in events.Scalars("heldout_gospa/total")} == {0, 2, 4}


def test_hparams_row(run, events):
    content = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    for name in NAMES:
        assert name.encode() in content
    (metric,) = events.Scalars("hparam/heldout")
    assert metric.value == pytest.approx(run.json()["heldout"]["after"])


def test_finished_run_is_only_reported_again(run, tmp_path_factory):
    before = (run.directory / "checkpoint.pt").read_bytes()
    rows, summary = run.rows(), run.json()
    with mock.patch.object(TrackerObjective, "__call__", side_effect=AssertionError("evaluated")):
        again = tune(run.directory, "logging=quiet")  # what is shown is not part of it
    assert again.status == 0, again.err
    assert (again.rows(), again.json()) == (rows, summary)
    assert (run.directory / "checkpoint.pt").read_bytes() == before


def test_interrupted_run_goes_on(run, tmp_path):
    """Stopped while it computes a step beyond the last checkpoint: the same table, summary and events."""
    evaluate, calls = TrackerObjective.__call__, []

    def stopping(self, values):
        calls.append(1)
        if len(calls) == 6:  # steps 0 to 2 made five calls
            raise KeyboardInterrupt
        return evaluate(self, values)

    with mock.patch.object(TrackerObjective, "__call__", stopping):
        assert tune(tmp_path, "tuning.checkpoint_every=2").status == 130
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["content"]
    assert len(state["records"]) == 2
    resumed = tune(tmp_path, "tuning.checkpoint_every=2", "logging.figures=false")
    assert resumed.status == 0, resumed.err
    assert resumed.rows() == run.rows()
    assert resumed.json() == run.json()
    events = resumed.events()
    assert [event.step for event in events.Scalars("tuning/objective")] == [0, 1, 2, 3, 4]


def test_checkpoint_of_another_configuration(run):
    before = {path: path.stat().st_mtime_ns for path in run.directory.iterdir() if path.name != ".hydra"}
    del before[run.directory / "tune.log"]
    other = tune(run.directory, "tuning.learning_rate=0.2")
    assert other.status == 1
    assert "key 'tuning.learning_rate': found 0.2, expected 0.3, as in" in other.err
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_tuned_configuration(run, launch):
    """Accepted by the tracking script, with overrides, and the values arrive."""
    best = run.json()["best"]
    assert run.tuned() == {"defaults": ["track", "_self_"], "model": Model().as_config(best)}
    outcome = launch(f"--config-dir={run.directory}", "--config-name=tuned", "seed=7")
    assert outcome.status == 0, outcome.err
    config = outcome.json("manifest.json")["config"]
    model = build_model(config["model"])
    assert {name: model.known()[name] for name in NAMES} == best
    assert config["tracker"]["particles"] == 100
    mean = outcome.json("metrics.json")["gospa"]["mean"]
    assert mean == pytest.approx(run.json()["heldout_gospa"]["after"], rel=1e-4)


@pytest.mark.parametrize("method", ["grid", "tpe"])
def test_search(tmp_path, method):
    if method == "tpe":
        pytest.importorskip("optuna", reason="the extra torchdt[tune] is not installed")
    fewer = [f"~hyperparameters.{name}" for name in NAMES[:3]]
    outcome = tune(tmp_path, f"tuning={method}", "tuning.budget_passes=8", "logging=quiet", *fewer)
    assert outcome.status == 0, outcome.err
    summary = outcome.json()
    assert (summary["method"], list(summary["best"])) == (method, ["birth_mean"])
    assert 4 <= summary["passes"] <= 8
    assert summary["heldout"]["after"] >= summary["heldout"]["before"]


def test_environment_and_share(tmp_path, launch):
    """One tone of the waveguide; what is tuned of it goes into the field, with the calibration off."""
    tone = ("scenario=matched_20", "field.freqs=[49]", "calibration=none", *SMALL, "scenario.num_steps=2")
    chosen = (
        "+hyperparameters.tilt_deg={start:0.2}",
        "+hyperparameters.eof_coefficients={trainable:false}",
        "+hyperparameters.mismatch_share={}",
        "~hyperparameters.power_shape",
        "~hyperparameters.birth_mean",
    )
    size = ("train_seeds=[0]", "heldout_seeds=[7]", "tuning.steps=1", "logging=quiet")
    outcome = tune(tmp_path, *tone, *chosen, *size, small=False)
    assert outcome.status == 0, outcome.err
    first, second = outcome.rows()
    assert float(first["tilt_deg"]) == 0.2
    assert float(second["tilt_deg"]) != 0.2
    assert float(first["gradient_mismatch_share"]) > 0
    tuned = outcome.tuned()
    assert tuned["field"] == {
        "draw": {k: outcome.json()["best"][k] for k in ("tilt_deg", "eof_coefficients")}
    }
    assert set(tuned["tracker"]) == {"mismatch_share"}
    assert set(tuned["model"]) == {"noise", "survival"}
    tracked = launch(f"--config-dir={tmp_path}", "--config-name=tuned", *tone[:2], *tone[3:], small=False)
    assert tracked.status == 0, tracked.err
    config = tracked.json("manifest.json")["config"]
    assert config["field"]["draw"] == tuned["field"]["draw"]
    assert not config["calibration"]["enabled"]


def test_files_instead_of_seeds(tmp_path, settings):
    paths = []
    for seed, steps in ((0, 5), (1, 4), (7, 5)):
        recording = simulate(settings(f"seed={seed}", f"scenario.num_steps={steps}"))
        paths.append(tmp_path / f"{seed}.npz")
        write_npz(paths[-1], recording)
    train, heldout = f"train_paths=[{paths[0]},{paths[1]}]", f"heldout_paths=[{paths[2]}]"
    folder = tmp_path / "run"
    fails(tune(folder, train, heldout), "key 'recordings': found lengths [5, 4]")
    outcome = tune(folder, train, heldout, "pad=true", "tuning.steps=1", "logging=quiet")
    assert outcome.status == 0, outcome.err
    assert math.isfinite(outcome.json()["heldout"]["after"])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("+hyperparameters.speed={}", "key 'hyperparameters.speed': found an unknown name"),
        ("+hyperparameters.tilt_deg={start:1.0}", "key 'hyperparameters.tilt_deg': found"),
        ("+hyperparameters.mismatch_share.start=[0.1]", "key 'hyperparameters.mismatch_share': found"),
        ("+hyperparameters.survival.start=1.5", "key 'hyperparameters.survival': found 1.5"),
        ("heldout_seeds=[1,7]", "key 'heldout_seeds': found [1] in both sets"),
        ("train_paths=[none.npz]", "key 'heldout_paths': found [], expected files for both sets"),
    ],
)
def test_bad_input(tmp_path, override, words):
    fails(tune(tmp_path, override), words)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["+hyperparameters.survival.begin=1"], "key 'hyperparameters.survival.begin': found an unknown key"),
        (
            ["+hyperparameters.survival.trainable=maybe"],
            "key 'hyperparameters.survival.trainable': found may",
        ),
        (["+hyperparameters.survival.prior={median:0.9}"], "key 'hyperparameters.survival.prior': found"),
        (["+hyperparameters.survival.prior={median:0.9,spread:x}"], "survival.prior.spread': found x"),
        (["hyperparameters.survival=3"], "key 'hyperparameters.survival': found 3"),
        (["train_seeds=[0,0]"], "key 'train_seeds': found \\[0, 0\\], expected at least one, each once"),
        (["heldout_seeds=[]"], "key 'heldout_seeds'"),
        (["tuning.steps=0"], "key 'tuning.steps': found 0, expected a positive integer"),
        (["tuning.method=tpe"], "key 'tuning.budget_passes'"),
        (["+tuning.stepz=1"], "key 'tuning.stepz': found an unknown key"),
        (["variants=[{survival: 0.9}]"], "key 'variants': found .*, expected null: the search"),
        (["data=npz", "data.path=x.npz"], "key 'data': found npz, expected its files as train_paths"),
    ],
)
def test_bad_settings(overrides, words):
    with configuration():
        config = compose("tune", overrides=overrides)
    with pytest.raises(InputError, match=words):
        settings_of(config)


def test_field_values_and_calibration_exclude_each_other(tmp_path):
    outcome = tune(tmp_path, "scenario=matched_20", "+hyperparameters.tilt_deg={}", "scenario.num_steps=2")
    fails(outcome, "key 'hyperparameters.tilt_deg': found calibration.enabled, expected calibration=none")


def test_broken_checkpoint(tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes(b"PK broken")
    outcome = tune(tmp_path)
    assert outcome.status == 1
    assert f"path '{tmp_path / 'checkpoint.pt'}': found a file of another kind" in outcome.err
    assert (tmp_path / "checkpoint.pt").read_bytes() == b"PK broken"


def test_every_tuning_option_composes():
    for option in ("gradient", "tpe", "grid"):
        with configuration():
            settings = settings_of(compose("tune", overrides=[f"tuning={option}"]))
        assert settings.tuning.method == option
        assert set(settings.hyperparameters) == set(NAMES)


def test_settings_survive_a_change():
    with configuration():
        settings = settings_of(compose("tune"))
    assert replace(settings, seed=1).hyperparameters == settings.hyperparameters
    with pytest.raises(InputError, match="key 'runs'"):
        replace(settings, runs=0)
