import csv
import json
import math
import subprocess
from importlib.metadata import version

import pytest
import torch

from torchdt.app.report import files
from torchdt.app.report.energy import hints
from torchdt.model.model import Model
from torchdt.model.motion.constant_velocity import ConstantVelocity

pytestmark = pytest.mark.slow


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_gospa_csv(tmp_path, score, times):
    path = tmp_path / "gospa.csv"
    files.write_gospa_csv(path, score, times)
    header = "run,step,time_s,gospa,localisation,missed,false,num_truth,num_estimated"
    assert path.read_text().splitlines()[0] == header
    table = rows(path)
    assert [(int(r["run"]), int(r["step"])) for r in table] == [(b, k) for b in range(2) for k in range(6)]
    assert list(table[0].values()) == ["0", "0", "0", "1", "1", "0", "0", "1", "1"]
    assert list(table[5].values()) == ["0", "5", "20.48", "101", "1", "100", "0", "2", "1"]
    assert list(table[8].values()) == ["1", "2", "68.192", "101", "1", "0", "100", "1", "2"]


def test_tracks_csv(tmp_path, history, times):
    path = tmp_path / "tracks.csv"
    files.write_tracks_csv(path, history, times)
    header = "run,step,time_s,label,existence,range_m,depth_m,range_rate_mps,depth_rate_mps,power_1,power_2"
    header += ",std_range_m,std_depth_m,std_range_rate_mps,std_depth_rate_mps,transmission"
    assert path.read_text().splitlines()[0] == header
    table = rows(path)
    assert len(table) == history.declared.sum()
    ghost = next(r for r in table if r["label"] == "12")
    assert (ghost["run"], ghost["step"], ghost["range_m"], ghost["power_2"]) == ("1", "2", "700", "1000")
    assert ghost["time_s"] == "68.192"
    assert list(ghost.values())[-5:] == ["2", "0.5", "0.25", "0.125", "0.75"]
    # Enough digits to give single precision back exactly.
    assert torch.tensor(float(table[0]["depth_rate_mps"])) == history.state[0, 0, 0, 3]
    assert torch.tensor(float(table[0]["range_m"])) == history.state[0, 0, 0, 0]
    assert torch.tensor(float(table[0]["existence"])) == history.existence[0, 0, 0]


def test_times_of_a_clock_that_began_long_ago_keep_their_fractions(tmp_path, history, score, times):
    times = 1771463910 + times
    files.write_tracks_csv(tmp_path / "tracks.csv", history, times)
    files.write_gospa_csv(tmp_path / "gospa.csv", score, times)
    for name in ("tracks.csv", "gospa.csv"):
        for row in rows(tmp_path / name):
            assert float(row["time_s"]) == pytest.approx(
                times[int(row["run"]), int(row["step"])].item(), rel=0, abs=1e-5
            )


def test_tracks_csv_of_another_field(tmp_path, history, times):
    bearing = history._replace(state=history.state[..., :2], state_std=history.state_std[..., :2])
    path = tmp_path / "tracks.csv"
    files.write_tracks_csv(path, bearing, times, ("bearing_deg", "bearing_rate_degps"))
    assert list(rows(path)[0])[5:7] == ["bearing_deg", "bearing_rate_degps"]
    assert list(rows(path)[0])[-3:] == ["std_bearing_deg", "std_bearing_rate_degps", "transmission"]
    with pytest.raises(ValueError, match="coordinates: found 2, expected 4"):
        files.write_tracks_csv(path, history, times, ("bearing_deg", "bearing_rate_degps"))


def test_tracks_csv_without_objects(tmp_path, history, times):
    path = tmp_path / "tracks.csv"
    files.write_tracks_csv(path, history._replace(declared=torch.zeros_like(history.declared)), times)
    assert rows(path) == []
    assert path.read_text().startswith("run,step,")


def test_metrics_json(tmp_path, history, score):
    path = tmp_path / "metrics.json"
    history.failed[1, 2:4] = True
    files.write_json(path, files.metrics_summary("direct", history, score, seed=5, seconds=2.0))
    assert json.loads(path.read_text()) == {
        "tracker": "direct",
        "num_steps": 6,
        "num_runs": 2,
        "seed": 5,
        "log_likelihood": -12.0,
        "failed_steps": 2,
        "energy": {"objects": 0.5, "interferers": 0.25, "noise": 0.125, "unexplained": 0.125},
        "hints": hints(history),
        "seconds": 2.0,
        "steps_per_second": 6.0,
        "gospa": {
            "mean": pytest.approx(1 + 50 + 100 / 12),
            "localisation": 1.0,
            "missed": 50.0,
            "false": pytest.approx(100 / 12),
        },
    }


def test_metrics_json_holds_no_nan(tmp_path, history):
    path = tmp_path / "metrics.json"
    unknown = history._replace(log_evidence=torch.full((2, 6), math.nan))
    summary = files.metrics_summary("mp_bp", unknown, None, seed=0, seconds=1.0)
    assert math.isnan(summary["log_likelihood"])
    files.write_json(path, summary)
    content = json.loads(path.read_text())
    assert content["tracker"] == "mp_bp"
    assert content["gospa"] is None
    assert content["log_likelihood"] is None


@pytest.mark.parametrize("scored", [True, False])
def test_variants_csv(tmp_path, history, score, scored):
    """Two variants of one run each: what is written is the mean over its six steps."""
    path = tmp_path / "variants.csv"
    variants = [Model(), Model(survival=0.5, motion=ConstantVelocity([1e-3, 2.0]))]
    files.write_variants_csv(path, variants, history, score if scored else None)
    assert path.read_text().splitlines()[0] == (
        "variant,survival,likelihood_power,effective_count,driving_variance,power_shape,noise_shape,birth_mean,"
        "gospa,localisation,missed,false,log_likelihood"
    )
    first, second = rows(path)
    assert (first["survival"], first["driving_variance"]) == ("0.95", "")
    assert (second["survival"], second["driving_variance"]) == ("0.5", "[0.001, 2.0]")
    for b, row in enumerate((first, second)):
        assert float(row["log_likelihood"]) == history.log_evidence[b].sum()
        for column, name in (("gospa", "total"), ("missed", "missed"), ("false", "false")):
            assert row[column] == (f"{getattr(score, name)[b].mean().item():.9g}" if scored else "")


def test_manifest(tmp_path):
    config = {"data": {"path": tmp_path / "x.npz", "cutoff": math.inf}, "tones": (49, 79)}
    path = tmp_path / "manifest.json"
    files.write_json(path, files.manifest(config, seed=3))
    content = json.loads(path.read_text())
    assert content["config"] == {"data": {"path": str(tmp_path / "x.npz"), "cutoff": None}, "tones": [49, 79]}
    assert content["seed"] == 3
    assert content["versions"]["torch"] == version("torch")
    assert set(content) == {"config", "seed", "versions", "git_commit"}


def test_git_commit(tmp_path):
    assert files._git_commit(tmp_path) is None

    def git(*arguments):
        subprocess.run(["git", "-C", tmp_path, *arguments], check=True, capture_output=True)

    git("init")
    assert files._git_commit(tmp_path) is None  # a checkout without a commit
    git("-c", "user.name=a", "-c", "user.email=a@b", "commit", "--allow-empty", "-m", "first")
    assert len(files._git_commit(tmp_path)) == 40
    inside = tmp_path / "lib"
    inside.mkdir()
    assert files._git_commit(inside) is None  # an installed copy inside a foreign checkout


def test_unknown_package_has_no_version():
    assert files._version("no-such-package-as-this") is None


def test_a_failed_write_leaves_nothing(tmp_path):
    path = tmp_path / "metrics.json"
    circular = {}
    circular["self"] = circular
    with pytest.raises(RecursionError):
        files.write_json(path, circular)
    assert list(tmp_path.iterdir()) == []
