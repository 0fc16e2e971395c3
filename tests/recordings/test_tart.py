import csv
import json
import os
from pathlib import Path

import pytest
from oracles.scripts import SMALL, call, load
from oracles.tart import sky, write_sky

pytestmark = pytest.mark.slow
FILES = (
    "metrics.json",
    "gospa.csv",
    "tracks.csv",
    "tart.json",
    "tart.csv",
    "manifest.json",
    "figures/sky.png",
)
QUICK = (*SMALL[1:], "data.average=1", "data.effective_count=50", "logging.progress=false")


def run(folder, path, *overrides):
    return call(load("tart"), f"data.path={path}", f"hydra.run.dir={folder}", *overrides)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A run on a made-up recording of one source."""
    folder = tmp_path_factory.mktemp("tart")
    arrays, _ = sky(size=12)
    status, out, err = run(folder / "run", write_sky(folder, arrays), *QUICK)
    assert status == 0, err
    return folder / "run", out


def test_one_row_for_each_method(outcome):
    folder, out = outcome
    assert [name for name in FILES if not (folder / name).is_file()] == []
    with (folder / "tart.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == ["direct", "peaks", "mp_bp"]
    assert all(row["method"] in out for row in rows)
    assert rows[1]["switches"] == ""


def test_the_source_is_found_and_scored_in_degrees(outcome):
    folder, _ = outcome
    scores = json.loads((folder / "tart.json").read_text())["direct"]
    assert scores["median_error"] < 1
    assert json.loads((folder / "metrics.json").read_text())["gospa"]["mean"] == pytest.approx(
        scores["gospa"]
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("data.average=0", "'data.average': found 0"),
        ("data.effective_count=0.5", "'data.effective_count': found 0.5"),
        ("data=npz", "'data': found npz, expected tart"),
    ],
)
def test_settings_that_do_not_fit(tmp_path, override, message):
    arrays, _ = sky()
    status, _, err = run(tmp_path / "run", write_sky(tmp_path, arrays), override, "logging.progress=false")
    assert status != 0
    assert message in err


@pytest.fixture(scope="module")
def ghana():
    folder = os.environ.get("TORCHDT_DATA")
    if not folder or not (Path(folder) / "tart_ghana").is_dir():
        pytest.skip("real recording: TORCHDT_DATA names no folder that holds tart_ghana")
    return Path(folder) / "tart_ghana" / "first_half.npz"


def test_satellites_over_ghana(tmp_path, ghana):
    """What docs/tart.md says, on steps of 42 covariances to be quick."""
    status, _, err = run(
        tmp_path, ghana, "data.average=42", "logging.progress=false", "logging.figures=false"
    )
    assert status == 0, err
    scores = json.loads((tmp_path / "tart.json").read_text())
    assert scores["direct"]["declared"] > 10
    assert scores["direct"]["close"] > 0.95
    assert scores["direct"]["median_error"] < 0.5
    assert scores["direct"]["switches"] == 0
    assert scores["direct"]["gospa"] < min(scores["peaks"]["gospa"], scores["mp_bp"]["gospa"])
