"""What a job makes of the result of its function: a number for sweeps, or rows that may have failed."""

import functools
import json
from types import SimpleNamespace

import pytest
from oracles.scripts import call, load

from torchdt.experiment import track
from torchdt.experiment.job import job

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
