"""The script as users start it."""

import json
import subprocess
import sys

import pytest
from oracles.scripts import FOLDER

pytestmark = pytest.mark.slow
SMALL = ("scenario=line_array", "scenario.num_steps=3", "tracker.particles=50", "logging=quiet")


def start(*arguments, folder):
    command = [sys.executable, str(FOLDER / "track.py"), *arguments]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )


def test_runs_from_any_folder(tmp_path):
    done = start(*SMALL, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # no progress bar, no warning
    (metrics,) = (tmp_path / "outputs" / "line_array").glob("*/metrics.json")
    assert json.loads(metrics.read_text())["num_steps"] == 3


def test_bad_input_is_an_exit_status(tmp_path):
    done = start(*SMALL, "tracker.particles=-4", folder=tmp_path)
    assert done.returncode != 0
    assert "key 'tracker.particles': found -4, expected a positive integer" in done.stderr


def test_help(tmp_path):
    done = start("--help", folder=tmp_path)
    assert done.returncode == 0
    (scenarios,) = (line for line in done.stdout.splitlines() if line.startswith("scenario: "))
    assert {"line_array", "swellex96"} <= set(scenarios.removeprefix("scenario: ").split(", "))
    assert "particles: 1000" in done.stdout
