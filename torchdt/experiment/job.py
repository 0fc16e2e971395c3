"""What `torchdt track` and `experiments/track.py` start, and likewise every other job."""

import contextlib
import functools
import logging
import sys
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import TextIO

import hydra
from omegaconf import DictConfig

from torchdt.experiment.progress import is_alone

log = logging.getLogger("py.warnings")


def job(name: str) -> Callable[[], None]:
    """The command line of a job, which Hydra reads from `sys.argv`.

    Job `x` is `run_x` of `torchdt.experiment.x`, with the configuration `x` of `torchdt.conf`, and its log is
    `x.log`. Warnings go there too. A number that it returns is for sweeps to minimise. Where it returns rows,
    one of which has an `error`, the exit status is 1; as part of a sweep the job has failed.
    """
    run = getattr(import_module(f"torchdt.experiment.{name}"), f"run_{name}")

    @functools.wraps(run)
    def task(config: DictConfig) -> float | None:
        with logged_warnings():
            result = run(config)
        failed = sum(bool(getattr(row, "error", None)) for row in result) if isinstance(result, list) else 0
        if failed and is_alone():
            sys.exit(1)  # the job has said what failed
        if failed:
            raise RuntimeError(f"{failed} of {len(result)} parts failed")
        return result if isinstance(result, float) else None

    return hydra.main(config_path="pkg://torchdt.conf", config_name=name, version_base="1.3")(task)


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
