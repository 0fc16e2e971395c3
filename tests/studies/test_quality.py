import csv
import json
from unittest import mock

import pytest
from hydra import compose
from oracles.scripts import SMALL, call, configuration, load

from studies.quality import QualitySettings
from torchdt.app import compare
from torchdt.app.report.scores import Quality
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow


def launch(directory):
    """A suite with a scenario that does not exist in the middle: exit status, output and rows."""
    small = ",".join(f'"{o}"' for o in ("calibration=none", *SMALL))
    status, out, _ = call(
        load("quality"),
        f"hydra.run.dir={directory}",
        "hydra/job_logging=none",
        f"overrides=[{small}]",
        "suite=[line_array,nowhere,empty]",
        "seeds=[0,1,3]",
        "separation=1",
        "name=small",
    )
    return status, out, json.loads((directory / "quality.json").read_text())["scenarios"]


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    directory = tmp_path_factory.mktemp("quality")
    return *launch(directory), directory


def test_every_scenario_has_a_row(outcome):
    _, out, content, directory = outcome
    with (directory / "quality.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["scenario"] for row in rows] == ["line_array", "nowhere", "empty"]
    assert list(rows[0]) == [name for name in Quality.__dataclass_fields__ if name != "gospa_by_run"]
    assert [entry["scenario"] for entry in content] == ["line_array", "nowhere", "empty"]
    assert all(entry["scenario"] in out for entry in content)
    line = content[0]
    assert line["runs"] == len(line["gospa_by_run"]) == 3
    assert line["gospa"] == pytest.approx(sum(line["gospa_by_run"]) / 3)
    assert line["gospa"] == pytest.approx(line["localisation"] + line["missed"] + line["false"])
    assert line["steps_per_second"] > 0
    assert line["real_time"] == pytest.approx(line["steps_per_second"] / 3)  # three runs, steps of one second
    assert content[2]["birth_delay"] is None


def test_failure_is_recorded_and_reported(outcome):
    status, out, content, _ = outcome
    assert status == 1
    assert "nowhere" in content[1]["error"]
    assert "nowhere failed" in out
    assert (content[0]["error"], content[2]["error"]) == ("", "")
    assert content[1]["gospa"] is None


def test_each_scenario_has_its_files(outcome):
    folder = outcome[-1] / "line_array"
    assert {path.name for path in folder.iterdir()} == {"gospa.csv", "figures", "tensorboard"}
    assert [path.name for path in (folder / "tensorboard").iterdir()] == ["small"]


def test_what_is_done_is_not_done_again(outcome):
    """Only what failed is tried once more, in the directory of the same command."""
    *_, content, directory = outcome
    with mock.patch.object(compare, "assess", side_effect=AssertionError):
        status, _, again = launch(directory)
    assert status == 1
    assert again == content


def test_the_suite_is_that_of_the_comparison():
    load("quality")  # its import brings the schema
    load("compare")
    with configuration():
        quality, comparison = compose("quality"), compose("compare")
    for key in ("suite", "separation", "switch_cost", "surface_step"):
        assert quality[key] == comparison[key]


@pytest.mark.parametrize("seeds", [[], [1, 1]])
def test_bad_seeds(seeds):
    with pytest.raises(InputError, match="key 'seeds'"):
        QualitySettings(suite=["a"], seeds=seeds)
