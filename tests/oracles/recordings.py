"""Runs on real recordings, where there are some."""

import csv
import json
import os
from pathlib import Path

import pytest
from oracles.scripts import call, load


def real(name: str) -> Path:
    """A file below `TORCHDT_DATA`; the test is skipped where it is not there."""
    folder = os.environ.get("TORCHDT_DATA")
    if not folder or not (Path(folder) / name).is_file():
        pytest.skip(f"real recording: TORCHDT_DATA names no folder that holds {name}")
    return Path(folder) / name


def tracked(directory: Path, experiment: str, path: Path, *overrides: str) -> tuple[dict, list[dict]]:
    """Metrics, and the rows of the tracks, of one run of an experiment."""
    quiet = ("logging=quiet", f"hydra.run.dir={directory}")
    chosen = (f"+experiment={experiment}", f"data.path={path}")
    status, _, err = call(load("track"), *chosen, *quiet, *overrides)
    assert status == 0, err
    with (directory / "tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return json.loads((directory / "metrics.json").read_text()), rows
