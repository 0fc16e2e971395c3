import contextlib
import csv
import importlib.util
import io
import json
import logging
import sys
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import pytest
from hydra import compose, initialize_config_module

from torchdt.experiment.build import simulate
from torchdt.experiment.settings import settings_of

SCRIPT = Path(__file__).parents[2] / "experiments" / "track.py"
SMALL = (
    "scenario=line_array",
    "scenario.num_steps=5",
    "tracker.slots=4",
    "tracker.births=4",
    "tracker.particles=100",
    "tracker.rounds=2",
    "tracker.round_size=32",
)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@dataclass
class Outcome:
    directory: Path
    status: int = 0
    values: list = field(default_factory=list)  # what run_track returned, one per job
    out: str = ""
    err: str = ""

    def rows(self, name):
        with (self.directory / name).open(newline="") as file:
            return list(csv.DictReader(file))

    def columns(self, name):
        return (self.directory / name).read_text().partition("\n")[0].split(",")

    def json(self, name):
        return json.loads((self.directory / name).read_text())

    @property
    def log(self):
        return (self.directory / "track.log").read_text()

    @property
    def scores(self):
        return [float(row["gospa"]) for row in self.rows("gospa.csv")]


@contextlib.contextmanager
def same_logging():
    """Undo what Hydra does to the root logger."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        yield
    finally:
        for handler in set(root.handlers) - set(handlers):
            handler.close()
        root.handlers[:] = handlers
        root.setLevel(level)


@pytest.fixture(scope="session")
def launch(tmp_path_factory):
    """Run `experiments/track.py` in this process, as the command line would."""
    spec = importlib.util.spec_from_file_location("track", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    run_track = script.run_track

    def launch(*overrides, small=True, terminal=False):
        """Small and without figures unless told otherwise."""
        outcome = Outcome(tmp_path_factory.mktemp("run", numbered=True))
        out, err = (Terminal(), Terminal()) if terminal else (io.StringIO(), io.StringIO())
        size = SMALL if small else ()
        places = [f"hydra.run.dir={outcome.directory}", f"hydra.sweep.dir={outcome.directory}"]
        flags = [o for o in overrides if o.startswith("-")]
        rest = [o for o in overrides if not o.startswith("-")]
        argv = [str(SCRIPT), *flags, "logging=quiet", *size, *places, *rest]

        def recorded(config):
            outcome.values.append(run_track(config))
            return outcome.values[-1]

        with (
            same_logging(),
            mock.patch.object(sys, "argv", argv),
            mock.patch.object(script, "run_track", recorded),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            try:
                script.main()
            except SystemExit as end:
                outcome.status = end.code
        outcome.out, outcome.err = out.getvalue(), err.getvalue()
        return outcome

    return launch


@pytest.fixture(scope="session")
def settings():
    """Settings of a composed configuration, small unless told otherwise."""

    def settings(*overrides, small=True):
        with initialize_config_module("torchdt.conf", version_base="1.3"):
            size = SMALL if small else ()
            return settings_of(compose("track", overrides=[*size, *overrides]))

    return settings


@pytest.fixture(scope="session")
def recording(settings):
    """Two simulated sequences."""
    return simulate(settings("runs=2"))
