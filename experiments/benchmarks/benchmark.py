"""Time and memory on this machine, beside plain implementations of the same mathematics.

A part of the benchmark is a function in `PARTS` that takes the settings and returns what it measured.
"""

import dataclasses
import logging
from collections.abc import Callable

import torch
from hydra import compose
from omegaconf import DictConfig, OmegaConf

from benchmarks.clock import describe_machine
from benchmarks.figures import benchmark_figure
from benchmarks.memory import measure_growth, measure_run_memory
from benchmarks.peers import measure_peers
from benchmarks.points import measure_points
from benchmarks.report import Measured, print_benchmark, write_benchmark
from benchmarks.sbl import measure_sbl
from benchmarks.scaling import measure_length_scaling, measure_update_scaling
from benchmarks.settings import BenchmarkSettings
from benchmarks.steps import measure_batch, measure_step
from benchmarks.update import measure_update
from torchdt.app.build import (
    build_recording,
    build_region,
    build_tracker,
    build_tracking_field,
    simulate,
)
from torchdt.app.claims import run_directory
from torchdt.app.report.console import plain_console
from torchdt.app.report.files import manifest, write_json
from torchdt.app.settings import TrackSettings, settings_of
from torchdt.baselines.detect.config import SblConfig
from torchdt.baselines.detect.sbl import SparseBayesianLearning
from torchdt.baselines.two_step import TwoStepConfig
from torchdt.core.errors import InputError, require
from torchdt.data.prepare import prepare
from torchdt.data.recording import Recording, validate
from torchdt.filter.direct import DirectTracker
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.measurement import Measurement

log = logging.getLogger(__name__)


def run_benchmark(config: DictConfig) -> list[Measured]:
    """Measure all parts; `benchmark.csv` and `benchmark.json` grow by a part each in Hydra's run directory.

    `benchmark.png` shows parts `step` and `scaling`, where these are measured.

    Returns:
        What was measured.

    Raises:
        InputError: where the configuration does not make sense.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, BenchmarkSettings)
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    directory = run_directory()
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), 0))
    machine = describe_machine(settings.device)
    rows: list[Measured] = []
    for part in settings.parts:
        rows += PARTS[part](settings)
        write_benchmark(directory, machine, rows)
    figure = benchmark_figure(rows)
    if figure is not None:
        figure.savefig(directory / "benchmark.png", dpi=150)
    print_benchmark(plain_console(), machine, rows)
    log.info("results in %s", directory)
    return rows


def compose_track(settings: BenchmarkSettings, *overrides: str) -> TrackSettings:
    """Settings of `experiments/track.py`, in single precision."""
    return settings_of(compose("track", overrides=[*overrides, f"device={settings.device}", "dtype=float32"]))


def build_direct(
    settings: BenchmarkSettings, runs: int, steps: int, key: str
) -> tuple[DirectTracker, Recording]:
    """The direct tracker of parts `step` and `scaling`, and the first steps of its data.

    Raises:
        InputError: where the settings are those of another tracker, or there are not as many steps.
    """
    track_settings = compose_track(settings, *settings.overrides, *settings.direct, f"runs={runs}")
    recording = build_recording(track_settings)
    total = recording.num_steps
    require(steps <= total, key, f"{steps} steps", f"at most the {total} of the scenario")
    tracker = build_tracker(track_settings, recording)
    if not isinstance(tracker, DirectTracker):
        raise InputError.of_key("direct", settings.direct, "those of direct tracking")
    return tracker, validate(snapshots=recording.data[:, :steps], step_s=recording.step_s)


def benchmark_update(settings: BenchmarkSettings) -> list[Measured]:
    """Part `update`, on random problems."""
    return measure_update(settings.device, settings.repeats, **dataclasses.asdict(settings.problem))


def benchmark_step(settings: BenchmarkSettings) -> list[Measured]:
    """Part `step`: parts of a step, then whole steps of a batch."""
    size, length = settings.problem.batch, max(settings.warm_up + 1, settings.batch_steps)
    key = "batch_steps" if length == settings.batch_steps else "warm_up"
    tracker, recording = build_direct(settings, size, length, key)
    rows = measure_step(tracker, recording, settings.warm_up, settings.repeats)
    return rows + measure_batch(tracker, recording, settings.repeats)


def benchmark_scaling(settings: BenchmarkSettings) -> list[Measured]:
    """Part `scaling`: random problems, then whole tracking."""
    base = dataclasses.asdict(settings.problem) | {"batch": 1}
    sizes = dataclasses.asdict(settings.scaling)
    lengths = sizes.pop("steps")
    tracker, recording = build_direct(settings, 1, lengths[-1], "scaling.steps")
    rows = measure_update_scaling(base, sizes, settings.repeats, settings.device)
    return rows + measure_length_scaling(tracker, recording, lengths, settings.repeats)


def benchmark_memory(settings: BenchmarkSettings) -> list[Measured]:
    """Part `memory`: a run of `experiments/track.py`, then a small problem for many steps."""
    online = compose_track(settings, *settings.online)
    recording = build_recording(online)
    tracker = build_tracker(online, recording)
    rows = measure_run_memory([*settings.run, f"device={settings.device}"])
    return rows + measure_growth(tracker, tracker.prepare(recording), settings.online_steps)


def benchmark_peers(settings: BenchmarkSettings) -> list[Measured]:
    """Part `peers`, whose scenes are always the same."""
    return measure_peers(settings.peer_particles, settings.repeats, settings.device)


def benchmark_sbl(settings: BenchmarkSettings) -> list[Measured]:
    """Part `sbl`: the detector and the data of a configuration of `experiments/track.py`.

    Raises:
        InputError: where the settings are those of another detector, or there are not as many steps.
    """
    choices = [*settings.overrides, *settings.detector]
    track_settings = compose_track(settings, "tracker=sbl_bp", *choices)
    config = track_settings.tracker
    if not isinstance(config, TwoStepConfig) or not isinstance(config.detector, SblConfig):
        raise InputError.of_key("detector", choices, "those of a tracker of SBL's points")
    recording = simulate(track_settings)
    total = recording.num_steps
    require(settings.steps <= total, "steps", settings.steps, f"at most the {total} of the scenario")
    field = build_tracking_field(track_settings, recording)
    region = build_region(track_settings, track_settings.torch_dtype)
    detector = SparseBayesianLearning(field, region, build_dictionary(field, region), config.detector)
    data = prepare(recording, field, region).measurement
    index = torch.linspace(0, total - 1, settings.steps).round().int().tolist()
    steps = [Measurement(*(t[0, k].clone() for t in data)) for k in index]
    return measure_sbl(detector, steps, settings.repeats)


def benchmark_points(settings: BenchmarkSettings) -> list[Measured]:
    """Part `points`, whose scenes are always the same."""
    return measure_points(settings.particles, settings.repeats, settings.device)


PARTS: dict[str, Callable[[BenchmarkSettings], list[Measured]]] = {
    "update": benchmark_update,
    "step": benchmark_step,
    "scaling": benchmark_scaling,
    "memory": benchmark_memory,
    "peers": benchmark_peers,
    "sbl": benchmark_sbl,
    "points": benchmark_points,
}
"""Parts by name: those of `benchmarks.settings`."""
