"""Does tracking work here: `torchdt doctor`.

The checks go through the installed configuration and the public interface, as a run does.
"""

import argparse
import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

import torch
from hydra import compose, initialize_config_module
from rich.console import Console
from rich.table import Table
from torch import Tensor

import torchdt
from torchdt.app.build import build_recording, build_tracker
from torchdt.app.report.files import PACKAGES
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings, settings_of
from torchdt.core.atomic import atomic_write
from torchdt.core.memory import free_memory_gb
from torchdt.core.random import RandomStreams
from torchdt.filter.direct import DirectTracker
from torchdt.filter.likelihood import log_likelihood
from torchdt.run.track import track

WORST_GOSPA = 1.0
"""Degrees; the scene scores about 0.4, and some 8 where nothing is reported."""

TOLERANCE = 1e-4
"""Relative error of the gradient. Proposals that move with the model are in the difference alone."""


class Check(NamedTuple):
    """What came of one part of the self-check.

    Attributes:
        name: of the part.
        passed: whether it did what it should.
        found: what it found, or the error.
        seconds: that it took.
    """

    name: str
    passed: bool
    found: str
    seconds: float


def main() -> None:
    """Print what is installed and the self-check; the exit status is 1 where a part of it failed."""
    description = "Print versions, extras, threads and devices, and check that tracking works here."
    argparse.ArgumentParser(description=description).parse_args()
    console = Console()
    table = Table("installation", "", show_edge=False)
    for name, value in installation().items():
        table.add_row(name, value)
    console.print(table, "")
    checks = []
    for check in run_checks(Path("outputs")):
        mark = "[green]ok    [/]" if check.passed else "[bold red]failed[/]"
        console.print(f"{mark} {check.seconds:5.2f} s  {check.name}:", end=" ")
        console.print(check.found, markup=False, highlight=False)
        checks.append(check)
    sys.exit(any(not check.passed for check in checks))


def installation() -> dict[str, str]:
    """What tracking depends on, by name, in words."""
    facts = {"torchdt in": str(Path(torchdt.__file__).parent), "python": platform.python_version()}
    facts |= {name: version_of(name) for name in PACKAGES}
    facts |= {f"extra {name}": found for name, found in extras().items()}
    facts["threads"] = f"{torch.get_num_threads()} on {os.cpu_count()} cores"
    for device in devices():
        facts[str(device)] = f"{free_memory_gb(device):.1f} GB free"
    return facts


def version_of(package: str) -> str:
    """Version of a package, or that it is missing."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def extras() -> dict[str, str]:
    """The packages behind each extra, with their versions; not those that it takes from other extras."""
    found: dict[str, list[str]] = {}
    for requirement in requires("torchdt") or ():
        if match := re.match(r"(?!torchdt\b)([\w.-]+).*extra == [\"'](\w+)", requirement):
            package, extra = match.groups()
            found.setdefault(extra, []).append(f"{package} {version_of(package)}")
    return {extra: ", ".join(packages) for extra, packages in found.items()}


def devices() -> list[torch.device]:
    """The processor, and every accelerator that PyTorch sees."""
    kind = torch.accelerator.current_accelerator()
    number = torch.accelerator.device_count() if kind is not None else 0
    return [torch.device("cpu"), *(torch.device(kind.type, i) for i in range(number) if kind is not None)]


def run_checks(outputs: Path) -> Iterator[Check]:
    """Check all parts, one after another; what fails does not keep the next one from being checked.

    Args:
        outputs: folder of the results of runs, which need not exist.
    """
    parts: dict[str, Callable[[], str]] = {"files": partial(check_files, outputs)}
    parts |= {f"tracking on {device}": partial(check_tracking, device) for device in devices()}
    parts["gradient"] = check_gradient
    for name, part in parts.items():
        start = time.perf_counter()
        try:
            found, passed = part(), True
        except Exception as error:  # whatever it is, it is what the user wants to know
            found, passed = f"{type(error).__name__}: {error}", False
        yield Check(name, passed, found, time.perf_counter() - start)


def check_files(outputs: Path) -> str:
    """Write and read a file where the results of runs go; nothing of it stays."""
    place = outputs if outputs.exists() else Path()
    with tempfile.TemporaryDirectory(dir=place, prefix=".doctor") as folder:
        path = Path(folder) / "written"
        with atomic_write(path) as file:
            file.write(b"torchdt")
        expect(path.read_bytes() == b"torchdt", "what was written is not what is read")
    return f"{place.resolve()} can be written"


def check_tracking(device: torch.device) -> str:
    """Simulate and track two sources on a line array."""
    settings = small_settings(f"device={device}")
    recording = build_recording(settings)
    start = time.perf_counter()
    history = track(recording, build_tracker(settings, recording), [settings.seed])
    speed = recording.num_steps / (time.perf_counter() - start)
    score = score_history(history, recording, settings)
    assert score is not None
    mean = score.total.mean().item()
    expect(mean < WORST_GOSPA, f"GOSPA is {mean:.2f} degrees, expected less than {WORST_GOSPA:g}")
    return f"GOSPA {mean:.2f} degrees, {speed:.0f} steps/s"


def check_gradient() -> str:
    """Differentiate the likelihood of a few steps in the survival probability, in double precision."""
    settings = small_settings("dtype=float64", "scenario.num_steps=6")
    recording = build_recording(settings)
    tracker = build_tracker(settings, recording)
    assert isinstance(tracker, DirectTracker)
    prepared = tracker.prepare(recording)

    def value(survival: Tensor) -> Tensor:
        streams = RandomStreams.from_seeds([settings.seed], (1,), torch.float64)
        varied = tracker.with_model(tracker.model.with_numbers({"survival": survival}))
        return log_likelihood(varied, prepared.measurement, prepared.priors, streams).sum()

    at, step = tracker.model.survival, 1e-4
    (slope,) = torch.autograd.grad(value(at.requires_grad_()), at)
    with torch.no_grad():
        difference = (value(at + step) - value(at - step)) / (2 * step)
    error = (slope / difference - 1).abs().item()
    expect(error < TOLERANCE, f"gradient {slope:.6g}, finite difference {difference:.6g}")
    return f"{slope:.6g}, a finite difference agrees to {error:.0e}"


def small_settings(*overrides: str) -> TrackSettings:
    """A scene of a few seconds, from the configuration as it is installed."""
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        return settings_of(compose("track", ["scenario=line_array", "tracker.particles=300", *overrides]))


def expect(holds: bool, otherwise: str) -> None:
    """Fail a check."""
    if not holds:
        raise RuntimeError(otherwise)
