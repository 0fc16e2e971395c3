"""The script as users start it: in a process of its own, from wherever they are."""

import json
import subprocess
import sys

import pytest
from oracles.scripts import FOLDER

pytestmark = pytest.mark.slow
SMALL = ("scenario=line_array", "scenario.num_steps=3", "tracker.particles=50", "logging=quiet")


def test_runs_from_any_folder(tmp_path):
    command = [sys.executable, str(FOLDER / "track.py"), *SMALL]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # no progress bar, no warning
    (metrics,) = (tmp_path / "outputs" / "line_array").glob("*/metrics.json")
    assert json.loads(metrics.read_text())["num_steps"] == 3
