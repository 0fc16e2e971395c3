"""Time and memory on this machine, beside plain implementations of the same mathematics.

A part of the benchmark is a function in `PARTS` that takes the settings and returns what it measured.
"""

import dataclasses
import importlib.util
import logging
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import fmean, median, quantiles
from types import ModuleType
from typing import Any

import numpy as np
import torch
from hydra import compose
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from torch import Tensor

import torchdt
from torchdt.detect.config import SblConfig
from torchdt.detect.dictionary import build_dictionary
from torchdt.detect.peaks import find_peaks
from torchdt.detect.points import Points
from torchdt.detect.sbl import SparseBayesianLearning
from torchdt.detect.spectrum import sparse_spectrum
from torchdt.errors import InputError, require
from torchdt.experiment.build import build_region, build_tracking_field, simulate
from torchdt.experiment.settings import TrackSettings, settings_of
from torchdt.model.measurement import Measurement
from torchdt.model.region import Coordinate, Region
from torchdt.mot.config import PointConfig
from torchdt.mot.likelihood import GaussianPosition
from torchdt.mot.tracker import PointTracker
from torchdt.prepare import prepare
from torchdt.random import RandomStreams
from torchdt.report.benchmark import HIGH, Measured, Plain, plain_rows, print_benchmark, write_benchmark
from torchdt.report.files import manifest, write_json
from torchdt.two_step import TwoStepConfig

log = logging.getLogger(__name__)

ORACLE = Path(torchdt.__file__).parents[1] / "tests" / "oracles" / "sparse_bayesian.py"
"""The plain formulations; part of a checkout, not of an installed copy."""

PEAKS = 256
"""More peaks than are compared."""

OBJECTS, FALSE, WARM_UP, TIMED = 5, 5, 10, 30
"""Of part `points`: objects, false points per step, steps before and while the clock runs."""

PROBE = """
import re, sys, torch
from pathlib import Path
torch.set_num_threads(int(sys.argv[2]))
detector, measurement = torch.load(sys.argv[1], weights_only=False)
def kibibytes(key):
    return re.search(key + r":\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]
before = kibibytes("VmRSS")
detector(measurement)
print(before, kibibytes("VmHWM"))
"""
"""Detects the points of one step and nothing else. Resource usage would count what the parent holds, too."""


@dataclass
class BenchmarkSettings:
    """Settings of `experiments/benchmark.py`.

    Attributes:
        name: of the machine or setting, for the run directory.
        parts: what is measured, of `PARTS`.
        repeats: of everything that is timed.
        overrides: of the configuration of `experiments/track.py` with `tracker=sbl_bp`, for part `sbl`.
        steps: of these data in which points are detected, evenly spread.
        particles: of each object in part `points`.
        device: of all that is torchdt.
        threads: of PyTorch's linear algebra; None leaves them to PyTorch.
    """

    name: str = "default"
    parts: list[str] = dataclasses.field(default_factory=list)
    repeats: int = 3
    overrides: list[str] = dataclasses.field(default_factory=list)
    steps: int = 3
    particles: int = 10_000
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        known = set(self.parts) <= set(PARTS) and len(set(self.parts)) == len(self.parts) > 0
        require(known, "parts", self.parts, f"some of {list(PARTS)}, each once")
        for key in ("repeats", "steps", "particles"):
            require(getattr(self, key) >= 1, key, getattr(self, key), "a positive integer")
        TrackSettings(device=self.device, threads=self.threads)  # has the same keys, and checks them


ConfigStore.instance().store(name="benchmark_schema", node=BenchmarkSettings)


def run_benchmark(config: DictConfig) -> list[Measured]:
    """Measure all parts; `benchmark.csv` and `benchmark.json` grow by a part each in Hydra's run directory.

    Returns:
        What was measured.

    Raises:
        InputError: where the configuration does not make sense.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, BenchmarkSettings)
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    directory = Path(HydraConfig.get().runtime.output_dir)
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), 0))
    machine = describe_machine(settings.device)
    rows: list[Measured] = []
    for part in settings.parts:
        rows += PARTS[part](settings)
        write_benchmark(directory, machine, rows)
    print_benchmark(Console(), machine, rows)
    log.info("results in %s", directory)
    return rows


def describe_machine(device: str) -> dict[str, object]:
    """What speeds depend on; rates are those of a product of two real matrices in single precision."""
    size = 1024
    square = torch.ones(size, size, device=device)
    array = np.ones((size, size), dtype=np.float32)
    rates = {}
    for name, product in (("torch", lambda: square @ square), ("numpy", lambda: array @ array)):
        product()
        rates[name] = 2e-9 * size**3 / median(clock(product, device)[0] for _ in range(5))
    return {
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "device": device,
        "threads": torch.get_num_threads(),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "torch_sgemm_gflops": rates["torch"],
        "numpy_sgemm_gflops": rates["numpy"],
    }


def clock(call: Callable[[], Any], device: str = "cpu") -> tuple[float, Any]:
    """Seconds until the device has done what a call asks of it, and what the call returns."""
    accelerated = torch.device(device).type != "cpu"
    if accelerated:
        torch.accelerator.synchronize()
    start = time.perf_counter()
    result = call()
    if accelerated:
        torch.accelerator.synchronize()
    return time.perf_counter() - start, result


def measure_sbl(settings: BenchmarkSettings) -> list[Measured]:
    """Sparse Bayesian learning, one step of data at a time, beside two plain formulations in NumPy.

    What is timed of torchdt is all of the detection: the powers, and the peaks moved off the grid and tested.
    Of the plain formulations it is the powers alone.

    Raises:
        InputError: where the settings are those of another detector, or there are not as many steps.
    """
    choices = ["tracker=sbl_bp", *settings.overrides, f"device={settings.device}", "dtype=float32"]
    track_settings = settings_of(compose("track", overrides=choices))
    config = track_settings.tracker
    if not isinstance(config, TwoStepConfig) or not isinstance(config.detector, SblConfig):
        raise InputError.of_key("overrides", settings.overrides, "those of a tracker of SBL's points")
    recording = simulate(track_settings)
    total = recording.num_steps
    require(settings.steps <= total, "steps", settings.steps, f"at most the {total} of the scenario")
    field = build_tracking_field(track_settings, recording)
    region = build_region(track_settings, track_settings.torch_dtype)
    detector = SparseBayesianLearning(field, region, build_dictionary(field, region), config.detector)
    data = prepare(recording, field, region).measurement
    index = torch.linspace(0, total - 1, settings.steps).round().int().tolist()
    steps = [Measurement(*(t[0, k].clone() for t in data)) for k in index]

    oracle = load_oracle()
    detector(steps[0])
    seconds, plain = [], []
    for step in steps:
        call = partial(detector, step)
        seconds.append(median(clock(call, settings.device)[0] for _ in range(settings.repeats)))
        if oracle is not None:
            plain.append(beside_matrix_products(oracle, detector, step))
    limits = f"prune {detector.config.prune:g}, at most {detector.config.max_iterations} iterations"
    note = f"float32, grid {region.grid_shape}, {limits}"
    rows = [Measured("sbl", "torchdt", median(seconds), "s/step", note)]
    if oracle is None:
        rows.append(Measured("sbl", "NumPy", math.nan, "s/step", f"left out: there is no {ORACLE}"))
    else:
        iteration = clock_outer_products(oracle, detector, steps[0], settings.repeats)
        rows += plain_rows(seconds, plain, iteration, settings.repeats)
    return rows + measure_memory(detector, steps[0])


def load_oracle() -> ModuleType | None:
    """The plain formulations; None where this is no checkout."""
    if not ORACLE.exists():
        return None
    spec = importlib.util.spec_from_file_location(ORACLE.stem, ORACLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def plain_problem(detector: SparseBayesianLearning, step: Measurement) -> tuple[NDArray, NDArray]:
    """Dictionary `(I, M, C)` and scatter / J `(I, M, M)` in double precision."""
    factor = step.factor.to(torch.complex128)
    scatter = factor @ factor.mH / step.num_snapshots[..., None, None]
    columns = detector.dictionary.response.mT.to(torch.complex128).contiguous()
    return columns.cpu().numpy(), scatter.cpu().numpy()


def beside_matrix_products(oracle: ModuleType, detector: SparseBayesianLearning, step: Measurement) -> Plain:
    """Run one step in NumPy to its end."""
    problem, grid, config = plain_problem(detector, step), detector.region.grid_shape, detector.config
    limits = {key: getattr(config, key) for key in ("tolerance", "min_iterations", "max_iterations")}
    learn = partial(oracle.learn, *problem, grid, config.sources)
    learn(max_iterations=1)
    seconds, learned = clock(partial(learn, **limits))
    own = sparse_spectrum(detector.dictionary.response, step, grid, config)
    peaks = (high_peaks(power, grid) for power in (torch.from_numpy(learned.power), own.power))
    return Plain(seconds, learned.iterations, int(own.iterations), *peaks)


def clock_outer_products(
    oracle: ModuleType, detector: SparseBayesianLearning, step: Measurement, repeats: int
) -> float:
    """Median seconds of an iteration with an M x M matrix for every column."""
    seconds: list[float] = []

    def sums(*arguments: NDArray) -> tuple[NDArray, NDArray]:
        taken, result = clock(partial(oracle.outer_products, *arguments))
        seconds.append(taken)
        return result

    problem, grid = plain_problem(detector, step), detector.region.grid_shape
    oracle.learn(*problem, grid, detector.config.sources, sums, max_iterations=repeats + 1)
    return median(seconds[1:])


def high_peaks(power: Tensor, grid_shape: tuple[int, ...]) -> set[int]:
    """Cells of all local maxima of `(C,)` powers above `HIGH` of the largest."""
    kept = torch.where(power > HIGH * power.max(), power, 0.0)
    cell, present = find_peaks(kept, grid_shape, PEAKS, 1.0)
    return set(cell[present].tolist())


def measure_memory(detector: SparseBayesianLearning, step: Measurement) -> list[Measured]:
    """Resident set of a fresh process of this machine that detects the points of one step."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "step.pt"
        torch.save((detector, step), path)
        command = [sys.executable, "-c", PROBE, str(path), str(torch.get_num_threads())]
        before, peak = map(int, subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout.split())
    note = "fresh process, PyTorch and dictionary included"
    above = "above what it held before detection"
    return [
        Measured("sbl", "peak memory of torchdt", peak / 1024, "MiB", note),
        Measured("sbl", "peak memory of detection", (peak - before) / 1024, "MiB", above),
    ]


def measure_points(settings: BenchmarkSettings) -> list[Measured]:
    """Conventional tracking of 5 objects from 10 points per step."""
    region = Region(
        [Coordinate(name, "m", 0.0, 1000.0, 20.0, -5.0, 5.0, 0.05) for name in ("x", "y")],
        torch.float32,
        settings.device,
    )
    config = PointConfig(particles=settings.particles, clutter_mean=FALSE)
    tracker = PointTracker(region, 1.0, config, GaussianPosition(region))
    seconds, declared, carried = [], [], []
    for seed in range(settings.repeats):
        points = simulate_points(tracker, seed)
        streams = RandomStreams.from_seeds([seed], (), torch.float32, settings.device)
        state = tracker.init((), 1)
        for k in range(len(points.present)):
            step = Points(*(t[k] for t in points))
            with torch.inference_mode():
                taken, (state, history) = clock(partial(tracker.step, state, step, streams), settings.device)
            if k >= WARM_UP:
                seconds.append(taken)
                declared.append(int(history.declared.sum()))
                carried.append(int((history.existence > 0).sum()))
    size = f"{settings.particles} particles, {config.slots} slots, {OBJECTS + FALSE} points per step"
    slow = 1e3 * quantiles(seconds, n=10)[-1]
    rows: list[tuple[str, float, str, str]] = [
        ("torchdt", 1e3 * median(seconds), "ms/step", f"{size}; median of {len(seconds)} steps"),
        ("torchdt, nine of ten steps", slow, "ms/step", "or less"),
        ("objects carried", fmean(carried), "per step", f"of {config.slots}"),
        ("objects declared", fmean(declared), "per step", f"there are {OBJECTS}"),
    ]
    return [Measured("points", *row) for row in rows]


def simulate_points(tracker: PointTracker, seed: int) -> Points:
    """Points `(K, Q)` of objects at constant rates, all of which are found, and of clutter.

    The first `OBJECTS` of the Q points are those of the objects.
    """
    region, spread = tracker.region, GaussianPosition(tracker.region).spread
    streams = RandomStreams.from_seeds([seed], (), region.low.dtype, region.low.device)
    # Who starts in the middle half of the region does not leave it in so many steps.
    num_steps = WARM_UP + TIMED
    start = torch.lerp(region.low, region.high, 0.25 + 0.5 * streams.uniform(OBJECTS, 2))
    rate = torch.lerp(region.rate_low, region.rate_high, streams.uniform(OBJECTS, 2))
    time_s = tracker.step_s * torch.arange(num_steps, device=start.device)[:, None, None]
    found = start + time_s * rate + spread * streams.normal(num_steps, OBJECTS, 2)
    false = torch.lerp(region.low, region.high, streams.uniform(num_steps, FALSE, 2))
    position = torch.cat([found, false], 1)
    strength = torch.ones_like(position[..., 0])
    return Points(position, strength, strength[..., None], strength > 0, strength[:, :1])


PARTS: dict[str, Callable[[BenchmarkSettings], list[Measured]]] = {
    "sbl": measure_sbl,
    "points": measure_points,
}
"""Parts by name."""
