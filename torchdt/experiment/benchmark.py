"""Time and memory on this machine, beside plain implementations of the same mathematics.

A part of the benchmark is a function in `PARTS` that takes the settings and returns what it measured.
"""

import dataclasses
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from hydra import compose
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from torchdt.benchmark.clock import describe_machine
from torchdt.benchmark.points import measure_points
from torchdt.benchmark.sbl import measure_sbl
from torchdt.detect.config import SblConfig
from torchdt.detect.dictionary import build_dictionary
from torchdt.detect.sbl import SparseBayesianLearning
from torchdt.errors import InputError, require
from torchdt.experiment.build import build_region, build_tracking_field, simulate
from torchdt.experiment.settings import TrackSettings, settings_of
from torchdt.model.measurement import Measurement
from torchdt.prepare import prepare
from torchdt.report.benchmark import Measured, print_benchmark, write_benchmark
from torchdt.report.files import manifest, write_json
from torchdt.two_step import TwoStepConfig

log = logging.getLogger(__name__)


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


def benchmark_sbl(settings: BenchmarkSettings) -> list[Measured]:
    """Part `sbl`: the detector and the data of a configuration of `experiments/track.py`.

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
    return measure_sbl(detector, steps, settings.repeats)


def benchmark_points(settings: BenchmarkSettings) -> list[Measured]:
    """Part `points`, whose scenes are always the same."""
    return measure_points(settings.particles, settings.repeats, settings.device)


PARTS: dict[str, Callable[[BenchmarkSettings], list[Measured]]] = {
    "sbl": benchmark_sbl,
    "points": benchmark_points,
}
"""Parts by name."""
