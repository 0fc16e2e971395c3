import csv
import json
import math
from unittest import mock

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from oracles.scripts import call, load
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchdt.app import stage
from torchdt.app.build import build_region
from torchdt.app.compare import CompareSettings, beside
from torchdt.app.outcomes import Outcome
from torchdt.app.report.compare_tables import Comparison
from torchdt.app.report.scores import Quality
from torchdt.core.errors import InputError
from torchdt.data.recording import validate
from torchdt.metrics import Gospa

pytestmark = pytest.mark.slow
SMALL = ("scenario.num_steps=8", "tracker.slots=4", "tracker.particles=100", "calibration=none")
TRACKERS = ["direct", "nowhere", "mp_bp"]


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A scenario and a tracker that do not exist among those that do, and who was called with what."""
    directory = tmp_path_factory.mktemp("compare")
    small = ",".join(f'"{o}"' for o in SMALL)
    names = ("simulate_each", "build_tracking_field", "surface_figure")
    spies = {name: mock.patch.object(stage, name, wraps=getattr(stage, name)) for name in names}
    calls = {name: spy.start() for name, spy in spies.items()}
    status, out, _ = call(
        load("compare"),
        f"hydra.run.dir={directory}",
        "hydra/job_logging=none",
        f"overrides=[{small}]",
        "suite=[nowhere,line_array]",
        f"trackers=[{','.join(TRACKERS)}]",
        "runs=2",
        "seed=3",
        "separation=1",
    )
    for spy in spies.values():
        spy.stop()
    return status, out, directory, calls


@pytest.fixture(scope="module")
def alone(launch):
    """The direct tracker by itself, on the same seeds."""
    return launch("scenario=line_array", *SMALL, "runs=2", "seed=3", small=False)


def test_every_scenario_and_tracker_has_a_row(outcome):
    _, out, directory, _ = outcome
    rows = rows_of(directory / "compare.csv")
    found = [(row["scenario"], row["tracker"]) for row in rows]
    assert found == [(scenario, name) for scenario in ("nowhere", "line_array") for name in TRACKERS]
    content = json.loads((directory / "compare.json").read_text())["rows"]
    assert set(content[0]) == set(Comparison.__dataclass_fields__)
    direct, _, conventional = content[3:]
    assert direct["runs"] == conventional["runs"] == 2
    assert (direct["ahead"], direct["difference"], direct["difference_ci"]) == (0, 0, 0)
    assert conventional["ahead"] == pytest.approx(1 - direct["gospa"] / conventional["gospa"])
    assert conventional["difference"] == pytest.approx(conventional["gospa"] - direct["gospa"])
    assert direct["real_time"] == pytest.approx(direct["steps_per_second"] / 2)  # two runs, steps of a second
    assert direct["seconds"] > 16 / direct["steps_per_second"]
    assert all(name in out for name in TRACKERS)


def test_failures_are_recorded_and_reported(outcome):
    status, out, directory, _ = outcome
    rows = rows_of(directory / "compare.csv")
    assert status == 1
    assert ["nowhere" in row["error"] for row in rows] == [True, True, True, False, True, False]
    assert [row["error"] for row in rows if "nowhere" not in row["error"]] == ["", ""]
    assert "nowhere, direct failed: " in out
    assert "line_array, nowhere failed: " in out


def test_trackers_share_recording_and_field(outcome):
    *_, calls = outcome
    assert calls["simulate_each"].call_count == calls["build_tracking_field"].call_count == 1


def test_a_tracker_scores_what_it_scores_alone(outcome, alone):
    _, _, directory, _ = outcome
    table = rows_of(directory / "line_array" / "gospa.csv")
    assert [row["tracker"] for row in table] == ["direct"] * 16 + ["mp_bp"] * 16
    assert [(row["run"], row["step"]) for row in table[:16]] == [
        (str(b), str(k)) for b in range(2) for k in range(8)
    ]
    np.testing.assert_allclose([float(row["gospa"]) for row in table[:16]], alone.scores, rtol=1e-6)
    assert [row["gospa"] for row in table[:16]] != [row["gospa"] for row in table[16:]]


def test_estimates_are_those_of_the_first_run_at_the_last_step(outcome, alone):
    *_, calls = outcome
    surface, _, estimates, truth, _ = calls["surface_figure"].call_args.args
    assert list(estimates) == ["direct", "mp_bp"]
    last = [row for row in alone.rows("tracks.csv") if (row["run"], row["step"]) == ("0", "7")]
    wanted = [float(row["bearing_deg"]) for row in last]
    assert wanted
    np.testing.assert_allclose(estimates["direct"][:, 0], wanted, rtol=1e-6)
    assert truth[0, 0] == pytest.approx(-40 + 7 * 40 / 60)
    assert surface.argmax() == pytest.approx((truth[0, 0] + 70) // 2, abs=1)  # cells of two degrees from -70


def test_files(outcome):
    _, _, directory, _ = outcome
    assert not (directory / "nowhere").exists()
    folder = directory / "line_array"
    assert {path.name for path in folder.iterdir()} == {"gospa.csv", "figures", "tensorboard"}
    assert {path.name for path in (folder / "figures").iterdir()} == {"gospa.png", "estimates.png"}
    table = rows_of(folder / "gospa.csv")
    for index, name in enumerate(("direct", "mp_bp")):
        read = EventAccumulator(str(folder / "tensorboard" / name)).Reload()
        values = np.array([float(row["gospa"]) for row in table]).reshape(2, 2, 8)[index].mean(0)
        np.testing.assert_allclose([e.value for e in read.Scalars("gospa/total")], values, rtol=1e-6)
    manifest = json.loads((directory / "manifest.json").read_text())
    assert (manifest["seed"], manifest["config"]["trackers"]) == (3, TRACKERS)


def test_beside_the_first():
    """Differences 4, 6 and 8 in the same runs: 6 on average, with standard deviation 2."""
    first = Quality("x", gospa=2.0, gospa_by_run=[1.0, 2.0, 3.0])
    this = Quality("x", gospa=8.0, gospa_by_run=[5.0, 8.0, 11.0], missed=4.0)
    row = beside("mp_bp", this, first)
    assert (row.scenario, row.tracker, row.gospa, row.missed) == ("x", "mp_bp", 8, 4)
    assert row.ahead == pytest.approx(0.75)
    assert row.difference == pytest.approx(6)
    assert row.difference_ci == pytest.approx(4.302653 * 2 / math.sqrt(3), rel=1e-6)
    assert beside("direct", first, this).ahead == pytest.approx(-3)
    assert beside("direct", first, this).difference == pytest.approx(-6)


def test_beside_nothing():
    zero = Quality("x", gospa=0.0, gospa_by_run=[0.0, 0.0])
    assert math.isnan(beside("mp_bp", zero, zero).ahead)
    assert beside("mp_bp", zero, zero).difference == 0
    row = beside("mp_bp", zero, None)
    assert row.gospa == 0
    assert math.isnan(row.ahead)
    assert math.isnan(row.difference)


def test_figures_of_a_waveguide(settings):
    track_settings = settings("scenario=swellex96", small=False)
    truth = torch.tensor([[[[3000.0, 58.0], [2000.0, 58.0]]] * 3] * 2)
    recording = validate(step_s=1.0, snapshots=torch.zeros(2, 3, 1, 1, 1, dtype=torch.complex64), truth=truth)
    surface = torch.rand(4, 3), [torch.linspace(0, 5000, 4), torch.linspace(0, 200, 3)]
    region, hidden = build_region(track_settings, torch.float32), torch.tensor([False, True, False])
    shared = stage.Stage(track_settings, range(2), recording, None, 0.0, region, hidden, 2, surface)
    score = Gospa(*[torch.tensor([[1.0, 5.0, 3.0]] * 2)] * 6)
    outcomes = {
        name: Outcome(Quality("x"), score, torch.full((number, 2), 50.0))
        for number, name in enumerate(("direct", "mp_bp"), start=1)
    }
    figures = stage.draw_comparison(shared, outcomes)
    drawn = {
        name: {line.get_label(): line.get_xydata() for line in figure.axes[0].lines}
        for name, figure in figures.items()
    }
    assert {"static", "moving", "array"} <= set(drawn["trajectory"])
    np.testing.assert_allclose(drawn["trajectory"]["moving"], [[2.0, 58.0]] * 3)
    np.testing.assert_allclose(drawn["trajectory"]["array"][:, 1], track_settings.field["element_depths"])
    assert {name: len(points) for name, points in drawn["estimates"].items()} == {
        "truth": 2,
        "direct": 1,
        "mp_bp": 2,
    }
    assert list(drawn["gospa"]) == ["direct, mean 2.0", "mp_bp, mean 2.0"]
    assert figures["gospa"].axes[0].get_ylabel() == "GOSPA (m)"


def test_defaults():
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        settings = OmegaConf.to_object(compose("compare"))
    assert settings.trackers == ["direct", "direct_paper", "mp_bp", "sbl_bp"]
    assert (settings.runs, settings.seed, settings.surface_step) == (10, 0, 200)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"trackers": []}, "trackers"),
        ({"trackers": ["direct", "direct"]}, "trackers"),
        ({"runs": 0}, "runs"),
    ],
)
def test_bad_settings(changes, key):
    with pytest.raises(InputError, match=f"key '{key}'"):
        CompareSettings(**({"suite": ["a"]} | changes))
