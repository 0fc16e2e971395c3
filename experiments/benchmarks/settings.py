"""Settings of the benchmark."""

import dataclasses
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar

from hydra.core.config_store import ConfigStore

from torchdt.app.settings import TrackSettings
from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Count, Name, Passes, Range, Steps, Threads

PARTS = ("update", "step", "scaling", "memory", "peers", "sbl", "points")
"""What can be measured."""


@dataclass
class ProblemSettings(Checked):
    """Size of random problems for the update; parts `update` and `scaling`.

    Attributes:
        slots: objects, all in use.
        particles: of each object.
        tones, sensors, snapshots: of the data.
        sweeps: of the update.
        batch: sequences in part `update`, and of tracking in part `step`; part `scaling` starts from one.
    """

    KEY: ClassVar[str] = "problem"

    slots: Count = 16
    particles: Count = 1000
    tones: Count = 7
    sensors: Count = 21
    snapshots: Count = 3
    sweeps: Passes = 3
    batch: Count = 16


@dataclass
class ScalingSettings(Checked):
    """Sizes of part `scaling`, each replacing that of the problem; `steps` are those of whole tracking."""

    KEY: ClassVar[str] = "scaling"

    slots: list[Count] = dataclasses.field(default_factory=lambda: [2, 4, 8, 16, 32])
    particles: list[Count] = dataclasses.field(default_factory=lambda: [250, 500, 1000, 2000, 4000, 8000])
    tones: list[Count] = dataclasses.field(default_factory=lambda: [1, 2, 4, 7, 14, 28])
    sensors: list[Count] = dataclasses.field(default_factory=lambda: [8, 16, 32, 64, 96])
    batch: list[Count] = dataclasses.field(default_factory=lambda: [1, 2, 4, 8, 16, 32])
    steps: list[Count] = dataclasses.field(default_factory=lambda: [10, 20, 40, 80])

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, sizes in vars(self).items():
            rising = len(sizes) >= 3 and all(a < b for a, b in pairwise(sizes))
            require(rising, f"scaling.{key}", sizes, "three or more rising positive integers")


@dataclass
class BenchmarkSettings(Checked):
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

    name: Name = "default"
    parts: list[str] = dataclasses.field(default_factory=list)
    repeats: Passes = 3
    overrides: list[str] = dataclasses.field(default_factory=list)
    direct: list[str] = dataclasses.field(default_factory=list)
    detector: list[str] = dataclasses.field(default_factory=list)
    problem: ProblemSettings = dataclasses.field(default_factory=ProblemSettings)
    scaling: ScalingSettings = dataclasses.field(default_factory=ScalingSettings)
    warm_up: Steps = 20
    batch_steps: Steps = 60
    run: list[str] = dataclasses.field(default_factory=list)
    online: list[str] = dataclasses.field(default_factory=list)
    online_steps: Annotated[int, Range("an integer from 10 up", low=10, most=1e7, whole=True)] = 10_000
    peer_particles: list[Count] = dataclasses.field(default_factory=lambda: [1000, 10_000])
    steps: Steps = 3
    particles: Count = 10_000
    device: str = "cpu"
    threads: Threads | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        known = set(self.parts) <= set(PARTS) and len(set(self.parts)) == len(self.parts) > 0
        require(known, "parts", self.parts, f"some of {list(PARTS)}, each once")
        require(bool(self.peer_particles), "peer_particles", self.peer_particles, "one number or more")
        TrackSettings(device=self.device, threads=self.threads)  # has the same keys, and checks them


ConfigStore.instance().store(name="benchmark_schema", node=BenchmarkSettings)
