"""What a job makes of the result of its function, and in what words it ends where there is none."""

import errno
import functools
import json
import logging
import threading
from types import SimpleNamespace

import pytest
from oracles.scripts import call, load
from oracles.storage import full_disk

from torchdt.app import cli, track
from torchdt.app.job import job
from torchdt.app.sweep import SweepReport
from torchdt.core.errors import InputError, StorageError

pytestmark = pytest.mark.slow
FINE, BROKEN = SimpleNamespace(error=""), SimpleNamespace(error="what went wrong")


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Exit status of a job that returns something, and the `job.json` of each of its jobs under multirun."""

    def start(result, *arguments):
        @functools.wraps(track.run_track)
        def run(config):
            return result

        monkeypatch.setattr(track, "run_track", run)
        places = (f"hydra.run.dir={tmp_path}", f"hydra.sweep.dir={tmp_path}")
        status, _, _ = call(load("track"), *arguments, *places)
        return status, [json.loads(path.read_text()) for path in sorted(tmp_path.glob("*/job.json"))]

    return start


@pytest.mark.parametrize(
    ("result", "status"), [(0.5, 0), (None, 0), ([FINE, FINE], 0), ([FINE, BROKEN], 1), ([], 0)]
)
def test_exit_status(start, result, status):
    assert start(result) == (status, [])


def test_rows_that_failed_are_a_failed_job_of_a_sweep(start):
    status, (job,) = start([FINE, BROKEN], "-m", "seed=3")
    assert status == 1
    assert (job["status"], job["error"]) == ("failed", "RuntimeError: 1 of 2 parts failed")


def test_numbers_are_for_sweeps(start):
    status, (job,) = start(0.5, "-m", "seed=3")
    assert status == 0
    assert job["result"] == 0.5


@pytest.mark.parametrize(("result", "returned"), [(0.5, 0.5), ([FINE, FINE], None)])
def test_rows_are_not_for_sweeps(monkeypatch, result, returned):
    monkeypatch.setattr(track, "run_track", lambda config: result)
    assert job("track").__wrapped__(None) == returned


@pytest.fixture
def stop(tmp_path, monkeypatch):
    """Exit status and standard error of a job whose function raises something, in `tmp_path`."""

    def stop(error, *arguments, before=lambda: None, **keys):
        @functools.wraps(track.run_track)
        def run(config):
            before()
            raise error

        monkeypatch.setattr(track, "run_track", run)
        places = (f"hydra.run.dir={tmp_path}", f"hydra.sweep.dir={tmp_path}")
        status, _, err = call(load("track"), *arguments, *places, **keys)
        return status, err

    return stop


@pytest.mark.parametrize("kind", [InputError, StorageError])
def test_errors_from_outside_are_said_in_a_line(stop, kind):
    assert stop(kind("key 'a': found b, expected c")) == (1, "key 'a': found b, expected c\n")


def test_other_errors_keep_their_traceback(stop):
    status, err = stop(ValueError("a fault"))
    assert status == 1
    assert "Traceback" in err
    assert "ValueError: a fault" in err


def test_traceback_on_request(stop):
    with pytest.raises(InputError, match="a line"):
        stop(InputError("a line"), full_error=True)


@pytest.mark.parametrize(("name", "ends"), [("checkpoint.pt", "goes on"), ("notes.txt", "starts anew")])
def test_an_interrupted_run_says_how_to_go_on(stop, tmp_path, name, ends):
    status, err = stop(KeyboardInterrupt(), before=(tmp_path / name).touch)
    assert (status, err) == (130, f"interrupted; the same command with hydra.run.dir={tmp_path} {ends}\n")


def test_an_interrupted_sweep_says_how_to_go_on(stop, tmp_path):
    status, err = stop(KeyboardInterrupt(), "-m", "seed=0,1")
    assert (status, err) == (130, f"interrupted; the same command with hydra.sweep.dir={tmp_path} goes on\n")


def test_interrupted_before_the_job(monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(SweepReport, "on_run_start", interrupt)
    assert call(load("track"), "hydra.run.dir=nowhere")[::2] == (130, "interrupted\n")
    monkeypatch.setattr(cli, "start", interrupt)
    monkeypatch.setattr(cli, "__file__", "track")  # the command
    assert call(cli, "track")[::2] == (130, "interrupted\n")


@pytest.mark.parametrize("mode", [(), ("-m", "seed=0,1")])
def test_a_directory_that_cannot_be_made(tmp_path, mode):
    (tmp_path / "file").touch()
    place = tmp_path / "file" / "run"
    status, _, err = call(load("track"), *mode, f"hydra.run.dir={place}", f"hydra.sweep.dir={place}")
    assert (status, err) == (1, f"cannot write {place}: Not a directory\n")


@pytest.mark.parametrize(("name", "key"), [("track", "scenario.name"), ("quality", "name")])
def test_a_name_that_leads_elsewhere_makes_no_folder(tmp_path, monkeypatch, name, key):
    folder = tmp_path / "a" / "b" / "c"
    folder.mkdir(parents=True)
    monkeypatch.chdir(folder)
    status, _, err = call(load(name), f"{key}=../../../x")
    assert (status, err.partition(",")[0]) == (1, f"key '{key}': found ../../../x")
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "b", "c"]


def test_a_disk_that_is_full_from_the_start(stop, tmp_path):
    with full_disk():
        status, err = stop(AssertionError("started"))
    assert (status, err) == (1, f"cannot write {tmp_path}: No space left on device\n")


def test_log_and_writers_do_not_echo_a_full_disk(stop, capsys):
    """Each line would bring a traceback, and so would the thread that writes events."""

    def write():
        with open("/dev/full", "w") as file:
            logging.StreamHandler(file).handle(logging.makeLogRecord({"msg": "line"}))
            with pytest.raises(OSError, match="No space"):
                file.close()
        thread = threading.Thread(target=refused)
        thread.start()
        thread.join()

    def refused():
        raise OSError(errno.ENOSPC, "No space left on device")

    status, err = stop(StorageError("cannot write it"), before=write)
    assert (status, err) == (1, "cannot write it\n")
