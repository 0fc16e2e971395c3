"""What a run logs: one line per event, at the levels that Hydra is told, and nothing beside the log."""

import ast
import logging
import re
import warnings
from pathlib import Path

import pytest
from oracles.scripts import SMALL, call, load

import torchdt
from torchdt.app import track
from torchdt.app.job import logged_warnings

pytestmark = pytest.mark.slow
FAST = ("scenario=line_array", *SMALL, "scenario.num_steps=3", "logging=quiet")
LINE = re.compile(r"\[\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3}\]\[([\w.]+)\]\[([A-Z]+)\] - .+")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Logger and level of each line in the log of a tiny run, and its standard output and error."""

    def run(*overrides):
        folder = tmp_path_factory.mktemp("logged")
        status, out, err = call(load("track"), *FAST, f"hydra.run.dir={folder}", *overrides)
        assert status == 0, err
        lines = (folder / "track.log").read_text().splitlines()
        return [LINE.fullmatch(line).groups() for line in lines], out, err

    return run


@pytest.fixture(scope="module")
def plain(run):
    return run()


def test_one_line_per_event(plain):
    lines, out, err = plain
    assert ("torchdt.app.track", "INFO") in lines
    assert "line_array: sequences 1, steps 3, tones 2, sensors 8\n" in out
    assert {level for _, level in lines} == {"INFO"}
    assert err == ""
    assert sum(bool(LINE.fullmatch(line)) for line in out.splitlines()) == len(lines)


def test_verbose_is_for_the_loggers_that_are_named(run, plain):
    try:
        lines, _, _ = run("hydra.verbose=torchdt.run.track")
    finally:
        logging.getLogger("torchdt.run.track").setLevel(logging.NOTSET)
    debug = ("torchdt.run.track", "DEBUG")
    assert debug in lines
    assert [line for line in lines if line != debug] == plain[0]


def test_levels(run):
    lines, _, _ = run("hydra.job_logging.root.level=WARNING")
    assert lines == []


def test_warnings_are_logged_in_one_line(run, monkeypatch):
    run_track = track.run_track

    def warning(config):
        warnings.warn("two\nlines", stacklevel=1)
        return run_track(config)

    warning.__module__ = run_track.__module__
    monkeypatch.setattr(track, "run_track", warning)
    lines, out, err = run()
    assert lines[0] == ("py.warnings", "WARNING")
    assert f"UserWarning: two lines ({__file__}:" in out
    assert err == ""


def test_warnings_are_as_before_afterwards():
    before = warnings.showwarning
    with logged_warnings():
        assert warnings.showwarning is not before
    assert warnings.showwarning is before


def test_the_library_prints_nothing():
    """Output is the business of commands, where it goes and at which level that of Hydra."""
    forbidden = {"print", "sys.stdout", "logging.basicConfig"}
    found = set()
    for path in Path(torchdt.__file__).parent.rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text()))
        names = {ast.unparse(node) for node in nodes if isinstance(node, ast.Name | ast.Attribute)}
        found |= {(path.name, name) for name in names & forbidden}
    assert found == {("cli.py", "sys.stdout")}
