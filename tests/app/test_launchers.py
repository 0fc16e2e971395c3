"""The same sweep by every launcher: one of its two jobs fails, the other does not notice."""

import json
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from hydra._internal.config_repository import ConfigRepository
from joblib.externals.loky import get_reusable_executor
from oracles.scripts import SMALL, call, load

pytestmark = pytest.mark.slow
ERROR = "InputError: key 'tracker.particles': found -1, expected a positive integer"
# A store that fits a small /dev/shm, and nothing that listens for a browser.
RAY = (
    "hydra.launcher.ray.init.object_store_memory=80000000",
    "+hydra.launcher.ray.init.include_dashboard=false",
)
LAUNCHERS = {"basic": (), "processes": ("hydra.launcher.n_jobs=2",), "slurm_local": (), "ray_pool": RAY}


@dataclass
class Sweep:
    directory: Path
    status: int
    out: str
    err: str

    def json(self, name):
        return json.loads((self.directory / name).read_text())


def sweep(directory, *arguments):
    size = ("scenario=line_array", *SMALL, "logging=quiet")
    return Sweep(directory, *call(load("track"), "-m", f"hydra.sweep.dir={directory}", *size, *arguments))


@pytest.fixture(scope="module", params=LAUNCHERS)
def done(request, tmp_path_factory):
    """What a launcher started is stopped, whatever happened."""
    name = request.param
    ray = pytest.importorskip("ray", reason="Ray is an extra of its own") if name == "ray_pool" else None
    try:
        launcher = (f"hydra/launcher={name}", *LAUNCHERS[name])
        return sweep(tmp_path_factory.mktemp(name), "tracker.particles=-1,60", *launcher)
    finally:
        if ray is not None:
            ray.shutdown()
        if name == "processes":
            get_reusable_executor().shutdown()


def test_one_failing_job_does_not_lose_the_others(done):
    assert not (done.directory / "0" / "metrics.json").exists()
    assert done.json("1/metrics.json")["num_steps"] == 5
    assert done.json("1/manifest.json")["config"]["tracker"]["particles"] == 60


def test_the_sweep_says_which_failed(done):
    assert done.status == 1
    (line,) = (line for line in done.out.splitlines() if "job 0 failed, " in line)
    assert "tracker.particles=-1" in line
    assert line.endswith(ERROR)
    assert "1 of 2 jobs completed" in done.out
    report = done.json("sweep.json")
    assert report["failed"] == 1
    assert report["jobs"] == [done.json("0/job.json"), done.json("1/job.json")]


def test_each_job_says_what_became_of_it(done):
    bad, good = done.json("sweep.json")["jobs"]
    assert (bad["number"], bad["status"], bad["error"], bad["result"]) == (0, "failed", ERROR, None)
    assert (good["number"], good["status"], good["error"]) == (1, "completed", None)
    assert "tracker.particles=60" in good["overrides"]
    assert good["result"] == pytest.approx(done.json("1/metrics.json")["gospa"]["mean"])
    assert good["seconds"] > 0
    assert ERROR in (done.directory / "0" / "track.log").read_text()  # with its traceback


def test_nothing_is_left_running(done):
    names = {child.name() for child in psutil.Process().children(recursive=True)}
    assert not {"raylet", "gcs_server"} & names


def test_jobs_of_an_earlier_sweep_do_not_count(tmp_path):
    assert sweep(tmp_path, "seed=0,1", "tracker.particles=-1").json("sweep.json")["failed"] == 2
    again = sweep(tmp_path, "seed=0")
    assert again.status == 0
    assert [job["number"] for job in again.json("sweep.json")["jobs"]] == [0]
    assert again.json("1/job.json")["status"] == "failed"


def test_what_slurm_is_asked_for(tmp_path, monkeypatch):
    """A program in the place of Slurm's keeps the script and refuses it."""
    for name in ("srun", "sbatch"):
        program = tmp_path / name
        program.write_text(f'#!/bin/sh\ncp "$1" {tmp_path}/script\necho no such partition >&2\nexit 1\n')
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    refused = sweep(tmp_path / "sweep", "seed=0,1", "hydra/launcher=slurm", "hydra.launcher.partition=night")
    assert refused.status == 1
    assert "no such partition" in refused.err
    lines = (tmp_path / "script").read_text().splitlines()
    wanted = ("cpus-per-task=4", "mem=8GB", "time=240", "partition=night", "array=0-1%2")
    assert {f"#SBATCH --{option}" for option in wanted} <= set(lines)
    assert "export OMP_NUM_THREADS=$SLURM_CPUS_PER_TASK" in lines


def test_unknown_launcher(tmp_path):
    refused = sweep(tmp_path, "seed=0,1", "hydra/launcher=joblibs")
    assert refused.status == 1
    assert "Could not find 'hydra/launcher/joblibs'" in refused.err
    assert set(LAUNCHERS) | {"slurm"} <= set(refused.err.split())
    assert "pip install" not in refused.err


@pytest.mark.parametrize(
    ("launcher", "plugin", "extra"),
    [
        ("processes", "joblib", "joblib"),
        ("slurm", "submitit_slurm", "slurm"),
        ("ray_pool", "ray", "ray"),
    ],
)
def test_a_launcher_whose_package_is_missing(tmp_path, monkeypatch, launcher, plugin, extra):
    known = ConfigRepository.load_config

    def load_config(self, config_path):
        return None if config_path == f"hydra/launcher/{plugin}" else known(self, config_path)

    monkeypatch.setattr(ConfigRepository, "load_config", load_config)
    refused = sweep(tmp_path, "seed=0,1", f"hydra/launcher={launcher}")
    assert refused.status == 1
    assert f"'hydra/launcher/{plugin}'" in refused.err
    assert refused.err.splitlines()[-1] == f"This launcher is an extra: pip install 'torchdt[{extra}]'"


def test_a_single_run_that_fails_says_why_and_no_more(launch):
    alone = launch("tracker.particles=-1")
    assert (alone.status, alone.err) == (1, ERROR.removeprefix("InputError: ") + "\n")
    assert not (alone.directory / "job.json").exists()
