"""What `torchdt track` and `experiments/track.py` start, and likewise every other job."""

import contextlib
import functools
import logging
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import TextIO

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import MissingConfigException
from omegaconf import DictConfig

from torchdt.app.progress import is_alone
from torchdt.app.search_path import configuration_from
from torchdt.app.tuned import check_command_line
from torchdt.core.endings import INTERRUPTED, end, wants_traceback
from torchdt.core.errors import InputError, StorageError
from torchdt.run.claim import release_all

log = logging.getLogger("py.warnings")

EXTRAS = {
    "hydra/launcher/joblib": "joblib",
    "hydra/launcher/submitit_slurm": "slurm",
    "hydra/launcher/submitit_local": "slurm",
    "hydra/launcher/ray": "ray",
}
"""Extras of torchdt that bring the launchers on which its presets build."""


def job(name: str, package: str = "torchdt.app", *folders: Path) -> Callable[[], None]:
    """The command line of a job, which Hydra reads from `sys.argv`.

    Job `x` is `run_x` of `package.x`, with the configuration `x` of `torchdt.conf` or of one of the folders,
    whose groups add to those of the package, and its log is `x.log`. Warnings go there too. A number that it
    returns is for sweeps to minimise. Where it returns rows, one of which has an `error`, the exit status is
    1; as part of a sweep the job has failed.

    What ends a job from outside is said in one line: bad input and storage that fails (both with a traceback
    under `HYDRA_FULL_ERROR=1`), Ctrl-C and how to go on, a launcher's missing package. At its end
    it gives back the directories that it has claimed.
    """
    run = getattr(import_module(f"{package}.{name}"), f"run_{name}")

    @functools.wraps(run)
    def task(config: DictConfig) -> float | None:
        with logged_warnings(), said_in_a_line(), without_echoes():
            result = run(config)
        failed = sum(bool(getattr(row, "error", None)) for row in result) if isinstance(result, list) else 0
        if failed and is_alone():
            sys.exit(1)  # the job has said what failed
        if failed:
            raise RuntimeError(f"{failed} of {len(result)} parts failed")
        return result if isinstance(result, float) else None

    start = hydra.main(config_path="pkg://torchdt.conf", config_name=name, version_base="1.3")(task)

    @functools.wraps(task)
    def main() -> None:
        try:
            check_command_line(sys.argv[1:])
            with configuration_from(*folders):
                start()
        except InputError as error:
            if wants_traceback():
                raise
            end(1, error)
        except KeyboardInterrupt:
            end(INTERRUPTED, "interrupted")
        except SystemExit as error:
            # Hydra has said that there is no such launcher, but not what brings it.
            missing = error.__context__
            extra = EXTRAS.get(str(getattr(missing, "missing_cfg_file", None)))
            if isinstance(missing, MissingConfigException) and extra:
                sys.stderr.write(f"This launcher is an extra: pip install 'torchdt[{extra}]'\n")
            raise
        finally:
            release_all()

    return main


@contextlib.contextmanager
def said_in_a_line() -> Iterator[None]:
    """End the program with a line instead of a traceback where the cause lies outside of it.

    Bad input and storage that fails are left to the sweep where the job is part of one.
    """
    try:
        yield
    except KeyboardInterrupt:
        end(INTERRUPTED, f"interrupted; {_going_on()}")
    except (InputError, StorageError) as error:
        if wants_traceback() or not is_alone():
            raise
        end(1, error)


def _going_on() -> str:
    """What to do after an interruption."""
    if not is_alone():
        return f"the same command with hydra.sweep.dir={HydraConfig.get().sweep.dir} goes on"
    directory = HydraConfig.get().runtime.output_dir
    kept = (Path(directory) / "checkpoint.pt").exists()
    return f"the same command with hydra.run.dir={directory} {'goes on' if kept else 'starts anew'}"


@contextlib.contextmanager
def without_echoes() -> Iterator[None]:
    """Keep log and event files from printing a traceback for whatever a full disk does not take.

    What matters ends the job with a `StorageError` of its own.
    """
    loud, logging.raiseExceptions = logging.raiseExceptions, False
    hook = threading.excepthook

    def show(failure: threading.ExceptHookArgs) -> None:
        if not isinstance(failure.exc_value, OSError):
            hook(failure)

    threading.excepthook = show
    try:
        yield
    finally:
        logging.raiseExceptions, threading.excepthook = loud, hook


@contextlib.contextmanager
def logged_warnings() -> Iterator[None]:
    """Send warnings to the log, a line each; `logging.captureWarnings` would take two or more."""

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        log.warning("%s: %s (%s:%d)", category.__name__, " ".join(str(message).split()), filename, lineno)

    shown = warnings.showwarning
    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = shown
