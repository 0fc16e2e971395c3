"""Interrupted runs of `compare` that the same command finishes, with the same numbers but for the time."""

import csv
import json
from contextlib import contextmanager
from unittest import mock

import pytest
from oracles.scripts import call, load
from oracles.storage import full_disk
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchdt.app import compare
from torchdt.filter.config import TrackerConfig
from torchdt.run.checkpoint import save_checkpoint

pytestmark = pytest.mark.slow
SMALL = ("scenario.num_steps=6", "tracker.slots=4", "tracker.particles=100", "calibration=none")
ARGUMENTS = (
    f"overrides={list(SMALL)}",
    "suite=[line_array,planar_array]",
    "trackers=[direct,mp_bp]",
    "runs=2",
    "separation=1",
)
MEASURED = {"seconds", "steps_per_second", "real_time"}


def start(directory, *overrides):
    return call(load("compare"), *ARGUMENTS, f"hydra.run.dir={directory}", *overrides)


@contextmanager
def watched(failing=None, error=RuntimeError):
    """What is computed, by scenario and tracker, one of which may fail."""
    assess, seen = compare.assess, []

    def assess_unless(scenario, stage, track_settings, settings):
        direct = isinstance(track_settings.tracker, TrackerConfig)
        seen.append((scenario, "direct" if direct else "mp_bp"))
        if seen[-1] == failing:
            raise error("stopped")
        return assess(scenario, stage, track_settings, settings)

    with mock.patch.object(compare, "assess", assess_unless):
        yield seen


def rows(directory):
    """Without what a clock measured."""
    found = json.loads((directory / "compare.json").read_text())["rows"]
    return [{key: value for key, value in row.items() if key not in MEASURED} for row in found]


def table(directory):
    with (directory / "compare.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    return [{key: value for key, value in row.items() if key not in MEASURED} for row in found]


def contents(directory, pattern):
    return {path.relative_to(directory): path.read_bytes() for path in directory.rglob(pattern)}


def written(directory):
    """All but what Hydra and the log say of the call."""
    return {
        path: content
        for pattern in ("*.json", "*.csv", "*.pt", "*.png")
        for path, content in contents(directory, pattern).items()
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = tmp_path_factory.mktemp("compare")
    status, _, err = start(directory)
    assert status == 0, err
    assert len(rows(directory)) == 4
    return directory


def assert_same(directory, whole):
    assert rows(directory) == rows(whole)
    assert table(directory) == table(whole)
    assert contents(directory, "gospa.csv") == contents(whole, "gospa.csv")
    assert contents(directory, "figures/*.png") == contents(whole, "figures/*.png")


def test_an_interrupted_suite_goes_on(whole, tmp_path):
    """Interrupted when a row has its files but does not yet count as done; its events are not doubled."""
    save, saved = compare.save_outcomes, []

    def save_one(*arguments):
        saved.append(1)
        if len(saved) == 2:
            raise KeyboardInterrupt
        save(*arguments)

    with mock.patch.object(compare, "save_outcomes", save_one):
        assert start(tmp_path)[0] == 130
    with watched() as seen:
        status, _, err = start(tmp_path)
    assert status == 0, err
    assert seen == [("line_array", "mp_bp"), ("planar_array", "direct"), ("planar_array", "mp_bp")]
    assert_same(tmp_path, whole)
    for tracker in ("direct", "mp_bp"):
        events = EventAccumulator(str(tmp_path / "line_array" / "tensorboard" / tracker)).Reload()
        assert [event.step for event in events.Scalars("gospa/total")] == list(range(6))


def test_a_full_disk_and_a_row_that_failed(whole, tmp_path):
    """The disk ends the run with one error; what failed before is tried again, for all to compare."""
    full = full_disk((tmp_path / "planar_array").exists)
    with watched(("line_array", "direct")), full:
        status, _, err = start(tmp_path)
    assert status == 1
    assert f"cannot write {tmp_path / 'planar_array'}" in err
    assert "No space left on device" in err
    assert [row["error"] for row in rows(tmp_path)] == ["RuntimeError: stopped", ""]
    with watched() as seen:
        status, _, err = start(tmp_path)
    assert status == 0, err
    assert seen == [("line_array", "direct"), ("planar_array", "direct"), ("planar_array", "mp_bp")]
    assert_same(tmp_path, whole)


def test_a_finished_suite_is_only_reported_again(whole):
    before = written(whole)
    with watched() as seen:
        status, out, err = start(whole)
    assert status == 0, err
    assert seen == []
    assert "planar_array" in out
    assert written(whole) == before


def test_another_suite_is_refused(whole):
    before = written(whole)
    status, _, err = start(whole, "runs=3")
    assert status == 1
    assert (
        f"key 'runs': found 3, expected 2, as in {whole / 'checkpoint.pt'}; another folder starts anew" in err
    )
    assert written(whole) == before


def test_the_checkpoint_of_another_job(tmp_path):
    save_checkpoint(tmp_path / "checkpoint.pt", "track", {}, {})
    status, _, err = start(tmp_path)
    assert status == 1
    assert f"path '{tmp_path / 'checkpoint.pt'}': found a checkpoint of 'track', expected one of 'comp" in err
    assert not (tmp_path / "manifest.json").exists()
