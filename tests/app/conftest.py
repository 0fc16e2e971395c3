import copy
import csv
import functools
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hydra import compose
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.override_parser.overrides_parser import OverridesParser
from oracles.scripts import SMALL, call, configuration, load, track_settings

from torchdt.app import track
from torchdt.app.build import simulate
from torchdt.app.parallel import track_in_chunks
from torchdt.app.settings import settings_of
from torchdt.app.track import set_up

SMALL_LINE = ("scenario=line_array", *SMALL)


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


@pytest.fixture(scope="session")
def launch(tmp_path_factory):
    """Run `experiments/track.py`."""
    run_track = track.run_track

    def launch(*overrides, small=True, terminal=False):
        """Small and without figures unless told otherwise."""
        outcome = Outcome(tmp_path_factory.mktemp("run", numbered=True))
        size = SMALL_LINE if small else ()
        places = [f"hydra.run.dir={outcome.directory}", f"hydra.sweep.dir={outcome.directory}"]
        flags = [o for o in overrides if o.startswith("-")]
        rest = [o for o in overrides if not o.startswith("-")]

        @functools.wraps(run_track)
        def recorded(config):
            outcome.values.append(run_track(config))
            return outcome.values[-1]

        with mock.patch.object(track, "run_track", recorded):
            outcome.status, outcome.out, outcome.err = call(
                load("track"), *flags, "logging=quiet", *size, *places, *rest, terminal=terminal
            )
        return outcome

    return launch


@pytest.fixture(scope="session")
def settings():
    return track_settings


@pytest.fixture(scope="session")
def composed():
    """The configuration of `attempt`."""
    with configuration():
        return compose("track", overrides=[*SMALL_LINE, "data=npz", "data.kind=simulated"])


@pytest.fixture(scope="session")
def attempt(composed):
    """What a job makes of its configuration, up to the tracks, for much less than composing it takes.

    Overrides choose no files of configuration; `data.kind=npz data.path=FILE` reads a recording.
    """

    def attempt(*overrides):
        config = copy.deepcopy(composed)
        parsed = OverridesParser.create().parse_overrides(list(overrides))
        ConfigLoaderImpl._apply_overrides_to_config(parsed, config)
        settings = settings_of(config)
        return track_in_chunks(settings, *set_up(settings))

    return attempt


@pytest.fixture(scope="session")
def recording(settings):
    """Two simulated sequences."""
    return simulate(settings("runs=2"))


@pytest.fixture(scope="session")
def measured():
    """Folder of the measured tables of SWellEx-96."""
    folder = os.environ.get("TORCHDT_DATA")
    if not folder or not (Path(folder) / "swellex96").is_dir():
        pytest.skip("measured data: TORCHDT_DATA names no folder that holds swellex96")
    return Path(folder) / "swellex96"


@pytest.fixture(scope="session")
def casts(measured):
    """Depths `(Z,)`, m, and sound speeds `(Z, number)`, m/s, of the casts that reach 160 m, down to there."""
    table = np.genfromtxt(measured / "ctd_casts.csv", delimiter=",", skip_header=1)
    table = table[table[:, 0] <= 160]
    return table[:, 0], table[:, 1:][:, ~np.isnan(table[:, 1:]).any(0)]
