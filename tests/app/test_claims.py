"""Two processes and one directory: the second one leaves it as it is."""

from unittest import mock

import pytest
import yaml
from hydra import compose, initialize_config_module
from hydra.core.hydra_config import HydraConfig
from oracles.processes import at_work
from oracles.scripts import SMALL, call, configured, load

from torchdt.app import track
from torchdt.app.claims import RUN, SWEEP

pytestmark = pytest.mark.slow
SIZE = ("scenario=line_array", *SMALL, "logging=quiet", "checkpoint_s=null")


def start(directory, *arguments):
    sweep = "-m" in arguments
    place = f"hydra.{'sweep' if sweep else 'run'}.dir={directory}"
    rest = [argument for argument in arguments if argument != "-m"]
    return call(load("track"), *["-m"] * sweep, place, *SIZE, *rest)


def files(directory):
    found = [path for path in directory.rglob("*") if path.is_file()]
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in found}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Holds what a process has written that is still at work, without a checkpoint."""
    root = tmp_path_factory.mktemp("root")
    assert start(root / "sweep" / "0", "seed=3")[0] == 0
    return root


@pytest.mark.parametrize(
    ("place", "held", "arguments"),
    [
        ("sweep/0", (RUN, "sweep/0"), ()),
        ("sweep/0", (SWEEP, "sweep"), ()),
        ("sweep", (SWEEP, "sweep"), ("-m",)),
        ("sweep", (RUN, "sweep/0"), ("-m",)),
        (".", (SWEEP, "sweep"), ("-m", "hydra.sweep.subdir=sweep/0")),
    ],
)
def test_a_refused_process_changes_nothing(root, place, held, arguments):
    """Not what Hydra writes, and not the log."""
    name, folder = held
    with at_work(root / folder, name):
        before = files(root)
        status, _, err = start(root / place, "seed=4", *arguments)
        assert files(root) == before
    assert status == 1
    found = f"path '{root / folder}': found process 1 of elsewhere at work there"
    assert err == f"{found}, expected its end, or another folder\n"


def test_neighbours_do_not_disturb(tmp_path, monkeypatch):
    monkeypatch.setattr(track, "run_track", lambda config: 0.5)
    with at_work(tmp_path / "1", RUN), at_work(tmp_path / "sweep", SWEEP):
        assert start(tmp_path / "0")[0] == 0
        assert start(tmp_path / "2", "-m")[0] == 0


@pytest.mark.parametrize("arguments", [(), ("-m",)])
def test_claims_end_with_the_command(tmp_path, arguments):
    """And last until then: also that of each job."""
    claims = []

    def run(config):
        claims.extend(path.relative_to(tmp_path) for path in tmp_path.rglob("*.lock"))
        raise KeyboardInterrupt

    with mock.patch.object(track, "run_track", run):
        assert start(tmp_path, *arguments)[0] == 130
    assert sorted(map(str, claims)) == ([SWEEP, f"0/{RUN}"] if arguments else [RUN])
    assert not list(tmp_path.rglob("*.lock"))


def test_a_job_claims_without_the_callback(tmp_path):
    """Where Hydra has none, its own files are not safe, but the results are."""
    with at_work(tmp_path, RUN):
        status, _, err = start(tmp_path, "~hydra/callbacks")
    assert status == 1
    assert "process 1 of elsewhere at work there" in err
    assert not (tmp_path / "manifest.json").exists()


@pytest.mark.parametrize("path", configured("*.yaml").values(), ids=lambda path: path.stem)
def test_all_names_are_of_their_own(path):
    content = yaml.safe_load(path.read_text())["hydra"]
    assert all(
        content[kind]["dir"].endswith("/${now:%Y-%m-%d_%H-%M-%S}_${unique:}") for kind in ("run", "sweep")
    )


def test_names_do_not_meet():
    """However few seconds pass; what belongs to one command has one name."""

    def names():
        config = compose("track", return_hydra_config=True)
        HydraConfig.instance().set_config(config)
        return [
            path.rpartition("_")[2]
            for path in (config.hydra.run.dir, config.hydra.sweep.dir, config.hydra.run.dir)
        ]

    with initialize_config_module("torchdt.conf", version_base="1.3"):
        (one, same, again), (other, *_) = names(), names()
    assert one == same == again != other
    assert len(one) == len(other) == 8


def test_all_jobs_of_a_sweep_are_in_one_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(track, "run_track", lambda config: 0.5)
    assert call(load("track"), "-m", "seed=0,1", *SIZE)[0] == 0
    assert len(list(tmp_path.glob("multirun/track/*"))) == 1
    assert len(list(tmp_path.glob("multirun/track/*/*/job.json"))) == 2
