"""Settings of the benchmark."""

import dataclasses
from dataclasses import dataclass
from itertools import pairwise

from hydra.core.config_store import ConfigStore

from torchdt.errors import require
from torchdt.experiment.settings import TrackSettings

PARTS = ("update", "step", "scaling", "memory", "peers", "sbl", "points")
"""What can be measured."""


@dataclass
class ProblemSettings:
    """Size of random problems for the update; parts `update` and `scaling`.

    Attributes:
        slots: objects, all in use.
        particles: of each object.
        tones, sensors, snapshots: of the data.
        sweeps: of the update.
        batch: sequences in part `update`, and of tracking in part `step`; part `scaling` starts from one.
    """

    slots: int = 16
    particles: int = 1000
    tones: int = 7
    sensors: int = 21
    snapshots: int = 3
    sweeps: int = 3
    batch: int = 16

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            require(value >= 1, f"problem.{key}", value, "a positive integer")


@dataclass
class ScalingSettings:
    """Sizes of part `scaling`, each replacing that of the problem; `steps` are those of whole tracking."""

    slots: list[int] = dataclasses.field(default_factory=lambda: [2, 4, 8, 16, 32])
    particles: list[int] = dataclasses.field(default_factory=lambda: [250, 500, 1000, 2000, 4000, 8000])
    tones: list[int] = dataclasses.field(default_factory=lambda: [1, 2, 4, 7, 14, 28])
    sensors: list[int] = dataclasses.field(default_factory=lambda: [8, 16, 32, 64, 96])
    batch: list[int] = dataclasses.field(default_factory=lambda: [1, 2, 4, 8, 16, 32])
    steps: list[int] = dataclasses.field(default_factory=lambda: [10, 20, 40, 80])

    def __post_init__(self) -> None:
        for key, sizes in vars(self).items():
            rising = len(sizes) >= 3 and sizes[0] >= 1 and all(a < b for a, b in pairwise(sizes))
            require(rising, f"scaling.{key}", sizes, "three or more rising positive integers")


@dataclass
class BenchmarkSettings:
    """Settings of `experiments/benchmark.py`.

    Attributes:
        name: of the machine or setting, for the run directory.
        parts: what is measured, of `PARTS`.
        repeats: of everything that is timed.
        overrides: of the configuration of `experiments/track.py`; data of parts `sbl`, `step` and `scaling`.
        direct: more of them, for the direct tracker of parts `step` and `scaling`.
        detector: more of them, for the detector of part `sbl`.
        problem: size of random problems.
        scaling: sizes of part `scaling`.
        warm_up: steps before the one that is timed in part `step`.
        batch_steps: of the sequences that are tracked as a batch and alone in part `step`.
        run: overrides of the run of which part `memory` measures the memory.
        online: of the small problem that part `memory` tracks step by step.
        online_steps: number of those steps.
        peer_particles: numbers of particles in part `peers`.
        steps: of the data in which points are detected in part `sbl`, evenly spread.
        particles: of each object in part `points`.
        device: of all that is torchdt.
        threads: of PyTorch's linear algebra; None leaves them to PyTorch.
    """

    name: str = "default"
    parts: list[str] = dataclasses.field(default_factory=list)
    repeats: int = 3
    overrides: list[str] = dataclasses.field(default_factory=list)
    direct: list[str] = dataclasses.field(default_factory=list)
    detector: list[str] = dataclasses.field(default_factory=list)
    problem: ProblemSettings = dataclasses.field(default_factory=ProblemSettings)
    scaling: ScalingSettings = dataclasses.field(default_factory=ScalingSettings)
    warm_up: int = 20
    batch_steps: int = 60
    run: list[str] = dataclasses.field(default_factory=list)
    online: list[str] = dataclasses.field(default_factory=list)
    online_steps: int = 10_000
    peer_particles: list[int] = dataclasses.field(default_factory=lambda: [1000, 10_000])
    steps: int = 3
    particles: int = 10_000
    device: str = "cpu"
    threads: int | None = None

    def __post_init__(self) -> None:
        known = set(self.parts) <= set(PARTS) and len(set(self.parts)) == len(self.parts) > 0
        require(known, "parts", self.parts, f"some of {list(PARTS)}, each once")
        for key in ("repeats", "warm_up", "batch_steps", "steps", "particles"):
            require(getattr(self, key) >= 1, key, getattr(self, key), "a positive integer")
        require(self.online_steps >= 10, "online_steps", self.online_steps, "an integer from 10 up")
        counts = self.peer_particles
        require(bool(counts) and min(counts) >= 1, "peer_particles", counts, "positive integers")
        TrackSettings(device=self.device, threads=self.threads)  # has the same keys, and checks them


ConfigStore.instance().store(name="benchmark_schema", node=BenchmarkSettings)
