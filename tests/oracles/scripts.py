"""The scripts of `experiments/` run in this process, as the command line would."""

import contextlib
import importlib.util
import io
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from unittest import mock

import yaml
from hydra import compose, initialize_config_module
from hydra._internal.hydra import Hydra
from hydra.plugins.sweeper import Sweeper

from laboratory import CONF as LABORATORY
from torchdt.app.search_path import configuration_from
from torchdt.app.settings import TrackSettings, settings_of

FOLDER = Path(__file__).parents[2] / "experiments"
SMALL = (
    "scenario.num_steps=5",
    "tracker.slots=4",
    "tracker.births=4",
    "tracker.particles=100",
    "tracker.proposal.rounds=2",
    "tracker.proposal.round_size=32",
)


PACKAGE = Path(__file__).parents[2] / "conf"
CONF = PACKAGE, LABORATORY
"""Where configuration is: that of the package, and that of jobs which are not in it."""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def configured(pattern: str) -> dict[str, Path]:
    """Files of configuration by their stem."""
    return {path.stem: path for folder in CONF for path in sorted(folder.glob(pattern))}


@contextlib.contextmanager
def configuration() -> Iterator[None]:
    """For `hydra.compose`: all that the scripts find."""
    with (
        quick_composition(),
        configuration_from(LABORATORY),
        initialize_config_module("torchdt.conf", version_base="1.3"),
    ):
        yield


def track_settings(*overrides: str, small: bool = True) -> TrackSettings:
    """Settings of `experiments/track.py`, of a small scenario unless told otherwise."""
    size = ("scenario=line_array", *SMALL) if small else ()
    with configuration():
        return settings_of(compose("track", overrides=[*size, *overrides]))


def load(name: str) -> ModuleType:
    """One script as a module, not run."""
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def call(
    script: ModuleType, *arguments: str, terminal: bool = False, full_error: bool = False
) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of `script.main`.

    Tracebacks of `full_error` are a matter of the test alone, whatever the environment asks Hydra for.
    """
    out, err = (Terminal(), Terminal()) if terminal else (io.StringIO(), io.StringIO())
    status = 0
    with (
        same_logging(),
        quick_composition(),
        mode_of_arguments(arguments),
        mock.patch.object(sys, "argv", [script.__file__, *arguments]),
        mock.patch.dict(os.environ, {"HYDRA_FULL_ERROR": str(int(full_error))}),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            script.main()
        except SystemExit as end:
            status = end.code
    return status, out.getvalue(), err.getvalue()


@contextlib.contextmanager
def same_logging() -> Iterator[None]:
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


@contextlib.contextmanager
def quick_composition() -> Iterator[None]:
    """YAML is read by libyaml, and Hydra does not compose the jobs of a sweep once more before the first.

    Half the time of a small sweep.
    """
    with (
        mock.patch.object(yaml, "SafeLoader", yaml.CSafeLoader),
        mock.patch.object(Sweeper, "validate_batch_is_legal"),
    ):
        yield


def mode_of_arguments(arguments: tuple[str, ...]) -> contextlib.AbstractContextManager:
    """Keep Hydra from composing everything once more for `hydra.mode`, which `-m` says already.

    That is a third of the time of a small run. Experiments and configurations of one's own may set the mode.
    """
    if any("experiment=" in argument or "--config" in argument for argument in arguments):
        return contextlib.nullcontext()
    return mock.patch.object(Hydra, "get_mode", return_value=None)
