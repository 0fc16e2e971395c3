"""How many snapshots sample covariances are worth, learned by `experiments/tune.py` from files."""

import csv
from dataclasses import replace
from functools import partial

import pytest
import torch
import yaml
from hydra import compose
from oracles.scripts import SMALL, call, configuration, load
from oracles.tart import sky, write_sky

from torchdt.app.build import build_recording, simulate
from torchdt.app.settings import settings_of
from torchdt.core.errors import InputError
from torchdt.data.npz import write_npz

pytestmark = pytest.mark.slow
SCRIPT = load("tune")  # it registers the schema of its configuration
TRUE, NOMINAL = 40, 15.0
SHORT = (
    "hyperparameters=count",
    "calibration=none",
    "tuning.slice_points=0",
    "tuning.gospa_every=99",
    "logging=quiet",
)


def settings(job, *overrides):
    with configuration():
        return settings_of(compose(job, overrides=["scenario=line_array", *SMALL, *overrides]))


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Two files of covariances of forty snapshots each, which say that they are of fifteen."""
    found = []
    for seed in (0, 7):
        made = simulate(settings("track", f"seed={seed}", f"scenario.num_snapshots={TRUE}"))
        covariance = made.snapshots.mT @ made.snapshots.conj() / TRUE
        found.append(tmp_path_factory.mktemp("covariances") / f"{seed}.npz")
        write_npz(found[-1], replace(made, snapshots=None, covariance=covariance, num_snapshots=NOMINAL))
    return found


def test_the_true_number_is_learned(tmp_path, paths):
    """It is known to sqrt(2 / (K I M^2)) = 6 % at best: 40 % is six errors."""
    sets = (f"train_paths=[{paths[0]}]", f"heldout_paths=[{paths[1]}]")
    size = ("scenario=line_array", *SMALL, *SHORT, "tuning.steps=12", "tuning.heldout_every=4")
    status, _, err = call(SCRIPT, *size, *sets, f"hydra.run.dir={tmp_path}")
    assert status == 0, err
    with (tmp_path / "tuning.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["effective_count"]) == pytest.approx(NOMINAL)
    learned = yaml.safe_load((tmp_path / "tuned.yaml").read_text())["model"]["effective_count"]
    assert learned == pytest.approx(TRUE, rel=0.4)
    # The tuned configuration is one of tracking.
    again = settings("track", "data=npz", f"data.path={paths[0]}", f"model.effective_count={learned}")
    assert again.statistical_model.effective_count == learned


def test_files_of_another_kind_are_read_as_data_says(tmp_path):
    path = write_sky(tmp_path, sky(num_steps=4)[0])
    other = path.rename(tmp_path / "other.npz")
    path = write_sky(tmp_path, sky(num_steps=6)[0])
    sets = (f"train_paths=[{path}]", f"heldout_paths=[{other}]")
    kind = ("scenario=tart", "field=tart", "data=tart", "data.average=2", "tracker=tart", *SMALL[1:])
    folder = tmp_path / "run"
    grid = ("tuning=grid", "tuning.budget_passes=6", "tuning.width=0.1")
    count = ("data.standing=false", "data.effective_count=30")
    status, _, err = call(SCRIPT, *kind, *SHORT, *grid, *count, *sets, f"hydra.run.dir={folder}")
    assert status == 0, err
    with (folder / "tuning.csv").open(newline="") as file:
        first = next(csv.DictReader(file))
    assert float(first["effective_count"]) == pytest.approx(30)
    assert torch.tensor([float(first["objective"]), float(first["heldout"])]).isfinite().all()


def test_a_kind_that_needs_a_path_asks_for_it():
    asks = partial(pytest.raises, InputError, match=r"'data.path': found None, expected the path of one file")
    found = settings("track", "data=tart", "field=tart", "scenario=tart", "calibration=none", "tracker=tart")
    with asks():
        build_recording(found)


def test_snapshots_have_no_count_to_learn(tmp_path):
    size = ("scenario=line_array", *SMALL, *SHORT, "train_seeds=[0]", "heldout_seeds=[7]")
    status, _, err = call(SCRIPT, *size, f"hydra.run.dir={tmp_path}")
    assert status == 1
    assert "key 'hyperparameters.effective_count': found neither start nor default" in err
