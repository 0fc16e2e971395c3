"""Memory that fresh processes hold: of a whole run, and of tracking that goes on and on."""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks.report import Measured
from torchdt.data.prepare import Prepared
from torchdt.filter.tracker import Tracker

STATUS = """
import re, sys
from pathlib import Path
def kibibytes(key):
    return int(re.search(key + r":\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""

RUN = """
import hydra
from torchdt.app.track import run_track
before = kibibytes("VmRSS")
hydra.main(config_path="pkg://torchdt.conf", config_name="track", version_base="1.3")(run_track)()
print(before, kibibytes("VmHWM"))
"""
"""Does what `experiments/track.py` does."""

ONLINE = """
import torch
from torchdt.core.random import RandomStreams
path, threads, steps, early = sys.argv[1], *map(int, sys.argv[2:])
torch.set_num_threads(threads)
tracker, prepared = torch.load(path, weights_only=False)
low, (size, length) = tracker.region.low, prepared.measurement.num_snapshots.shape[:2]
streams = RandomStreams.from_seeds(range(size), (size,), low.dtype, low.device)
state = tracker.init(prepared.priors)
with torch.inference_mode():
    for k in range(steps):
        state, _ = tracker.step(state, prepared.measurement.at(k % length), prepared.priors, streams)
        if k + 1 == early:
            first = kibibytes("VmRSS")
print(first, kibibytes("VmRSS"))
"""
"""Tracks and keeps nothing but the state; the data start again at their end."""


def measure_run_memory(overrides: Sequence[str]) -> list[Measured]:
    """Largest resident set of a fresh process that runs `experiments/track.py`.

    Args:
        overrides: of its configuration.
    """
    with tempfile.TemporaryDirectory() as folder:
        places = (f"hydra.run.dir={folder}", f"threads={torch.get_num_threads()}")
        before, peak = probe(RUN, *overrides, *places)
    said = " ".join(overrides) or "the default configuration"
    rows = [
        ("peak memory of a run", peak, f"fresh process, PyTorch included: {said}"),
        ("before the run", before, "all imported, nothing done"),
    ]
    return [Measured("memory", name, value / 1024, "MiB", note) for name, value, note in rows]


def measure_growth(tracker: Tracker[Any], prepared: Prepared, steps: int) -> list[Measured]:
    """Resident set of a fresh process that tracks step by step, after a tenth of the steps and after all.

    Args:
        tracker: the tracker.
        prepared: data of batch `(B, K)`, over and over again.
        steps: number of them, at least 10.
    """
    early = steps // 10
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "online.pt"
        torch.save((tracker, prepared), path)
        first, last = probe(ONLINE, str(path), *map(str, (torch.get_num_threads(), steps, early)))
    rows = [
        (f"resident after {early} steps", first, "step by step, fresh process"),
        (f"resident after {steps} steps", last, "likewise"),
        ("growth in between", last - first, f"in {steps - early} steps"),
    ]
    return [Measured("memory", name, value / 1024, "MiB", note) for name, value, note in rows]


def probe(program: str, *arguments: str) -> tuple[int, int]:
    """The two numbers in the last line that a fresh process of Python prints.

    Resource usage would count what the parent holds, too.

    Args:
        program: may call `kibibytes` of `VmRSS`, what it holds, or `VmHWM`, the most that it held.
        arguments: its `sys.argv[1:]`.
    """
    command = [sys.executable, "-c", STATUS + program, *arguments]
    printed = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    first, last = printed.splitlines()[-1].split()
    return int(first), int(last)
