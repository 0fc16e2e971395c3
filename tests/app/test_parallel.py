"""How many threads and chunks a run has; no launcher is needed to know what one would do."""

import os
import subprocess
import sys

import pytest
import torch

from torchdt.app.parallel import num_workers, set_threads, track_in_chunks
from torchdt.app.settings import TrackSettings

pytestmark = pytest.mark.slow
JOB = """
import torch
from torchdt.app.parallel import num_workers, set_threads
from torchdt.app.settings import TrackSettings
set_threads(TrackSettings())
print(torch.get_num_threads(), num_workers(TrackSettings(), 100))
"""


@pytest.fixture
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(("batch_size", "expected"), [(1, 1), (7, 1), (8, 3), (100, 3)])
def test_large_batches_have_a_worker_for_each_thread(three_threads, batch_size, expected):
    assert num_workers(TrackSettings(), batch_size) == expected
    assert num_workers(TrackSettings(device="meta"), batch_size) == 1
    assert num_workers(TrackSettings(workers=2), batch_size) == 2


def test_threads_are_those_that_are_set(three_threads):
    set_threads(TrackSettings())
    assert torch.get_num_threads() == 3
    set_threads(TrackSettings(threads=2))
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("threads", [1, 2])
def test_jobs_keep_to_the_threads_a_launcher_gives_them(threads):
    """Joblib starts the processes of jobs with this variable set to their share of the cores."""
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    environment.pop("MKL_NUM_THREADS", None)
    done = subprocess.run(
        [sys.executable, "-c", JOB], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(threads)] * 2


def test_memory_and_workers_reach_the_tracker(monkeypatch):
    found = {}
    monkeypatch.setattr("torchdt.app.parallel.track", lambda *_, **options: found.update(options))

    class Recording:
        batch_size = 2

    track_in_chunks(TrackSettings(memory_gb=0.5, workers=3), Recording(), None, [0, 1])
    assert found == {"memory_gb": 0.5, "workers": 3, "keep": None}
