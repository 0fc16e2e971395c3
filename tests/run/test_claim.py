"""A folder has one process at a time, and a dead one has none."""

import errno
import fcntl
import os
import signal
import subprocess
import sys

import pytest
from oracles.processes import at_work

from torchdt.core.errors import InputError, StorageError
from torchdt.run import claim as module
from torchdt.run.claim import InUseError, claim, refuse_claimed, release, release_all

NAME = ".lock"
HOLD = (
    "import sys, torchdt.run.claim as c; c.claim(sys.argv[1], '.lock'); print('has it', flush=True); input()"
)


@pytest.fixture(autouse=True)
def _no_claims_are_left():
    yield
    release_all()
    assert not module._held


def refused(folder):
    with pytest.raises(InUseError) as error:
        claim(folder, NAME)
    return str(error.value)


def test_who_is_at_work_is_named(tmp_path):
    with at_work(tmp_path, NAME):
        found = f"path '{tmp_path}': found process 1 of elsewhere at work there"
        assert refused(tmp_path) == f"{found}, expected its end, or another folder"
    claim(tmp_path, NAME)
    assert issubclass(InUseError, InputError)


def test_a_process_that_is_killed_has_no_claims(tmp_path):
    """What it leaves is its file, which is no claim."""
    arguments = [sys.executable, "-c", HOLD, tmp_path / "new"]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "has it\n"
        assert f"process {process.pid} of {os.uname().nodename} at work there" in refused(tmp_path / "new")
        process.kill()
        assert process.wait() == -signal.SIGKILL
    assert (tmp_path / "new" / NAME).exists()
    claim(tmp_path / "new", NAME)


def test_a_process_has_its_claim_until_it_gives_it_back(tmp_path):
    """Claiming twice is claiming once; the file goes with the claim."""
    claim(tmp_path, NAME)
    claim(os.path.relpath(tmp_path), NAME)
    refuse_claimed(tmp_path / NAME)  # others alone are refused
    assert locked(tmp_path)
    release(tmp_path, NAME)
    release(tmp_path, NAME)
    assert not any(tmp_path.iterdir())


def locked(folder):
    with open(folder / NAME, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False


def test_claims_of_other_names_do_not_meet(tmp_path):
    with at_work(tmp_path, ".other"):
        claim(tmp_path, NAME)
        with pytest.raises(InUseError, match="process 1 of elsewhere"):
            refuse_claimed(tmp_path / ".other")
    refuse_claimed(tmp_path / ".other")
    refuse_claimed(tmp_path / "nowhere" / ".other")


def test_a_file_that_its_holder_takes_away_is_no_claim(tmp_path, monkeypatch):
    """It goes between opening and locking: a lock on it would keep nobody out."""
    lock, calls = module._lock, []

    def lock_late(file, kind):
        if not calls:
            (tmp_path / NAME).unlink()
        calls.append(kind)
        return lock(file, kind)

    monkeypatch.setattr(module, "_lock", lock_late)
    claim(tmp_path, NAME)
    assert len(calls) == 2
    assert locked(tmp_path)


def test_a_file_system_without_locks(tmp_path, monkeypatch, caplog):
    def refuse(file, kind):
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", refuse)
    claim(tmp_path, NAME)
    assert "this file system has no locks, nothing keeps a second process out" in caplog.text


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"^cannot write .*file/run/\.lock: Not a directory$"):
        claim(tmp_path / "file" / "run", NAME)
