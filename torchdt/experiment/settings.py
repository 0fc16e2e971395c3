"""Configuration of the experiments: schemas for Hydra, range checks at the edge."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from torchdt.calibration.environment import CalibrationConfig
from torchdt.config import ObjectConfig, TrackerConfig
from torchdt.detect.config import PursuitConfig, SblConfig
from torchdt.errors import InputError, require
from torchdt.scenario.settings import ScenarioSettings
from torchdt.two_step import TwoStepConfig
from torchdt.variants import variant_configs

MANY = 8
"""Sequences from which on threads track chunks of a batch, instead of sharing each operation."""


@dataclass
class DataSettings:
    """Where the snapshots come from.

    Attributes:
        kind: `simulated` or `npz`.
        path: of the file, or a list of paths; their sequences are tracked as one batch.
    """

    kind: str = "simulated"
    path: Any = None

    def __post_init__(self) -> None:
        require(self.kind in ("simulated", "npz"), "data.kind", self.kind, "simulated or npz")
        given = bool(self.paths) and all(isinstance(path, str) and path for path in self.paths)
        expected = "the path of a file or a list of paths"
        require(self.kind == "simulated" or given, "data.path", self.path, expected)

    @property
    def paths(self) -> list[str]:
        """The files."""
        return list(self.path) if isinstance(self.path, list | tuple) else [self.path]


@dataclass
class StaticCopySettings:
    """A standing source made from one step of the data, see `torchdt.signals.static_copy`.

    Attributes:
        step: that is added to every step; None adds none.
        gain_db: of the data as they were, dB.
    """

    step: int | None = None
    gain_db: float = -3.0

    def __post_init__(self) -> None:
        require(math.isfinite(self.gain_db), "data.static_copy.gain_db", self.gain_db, "a finite number")


@dataclass
class SignalSettings(DataSettings):
    """Raw signals; `torchdt.signals.spectra` makes snapshots of the field's tones of them.

    Attributes:
        kind: `wav`, `npy` or `sio`.
        path: of one file, whose channels are the field's sensors in their order.
        sample_rate: Hz; may be left out where the file says it.
        window_length, hop: samples of each Fourier transform, and from one to the next.
        snapshots_per_step: J.
        search_hz: how far from its nominal frequency a tone is looked for, Hz.
        start_s, duration_s: part of the file, s; None goes on to its end.
        truth: path of a table, see `torchdt.signals.truth`.
        truth_path: without a table, the path of the scenario that the source takes from `start_s` on; without
            either there is no truth.
        truth_depth_m: depth that goes with a table of ranges alone.
        static_copy: adds a standing source.
    """

    kind: str = "wav"
    sample_rate: float | None = None
    window_length: int = 4096
    hop: int = 2048
    snapshots_per_step: int = 3
    search_hz: float = 1.0
    start_s: float = 0.0
    duration_s: float | None = None
    truth: str | None = None
    truth_path: str | None = None
    truth_depth_m: float | None = None
    static_copy: StaticCopySettings = dataclasses.field(default_factory=StaticCopySettings)

    def __post_init__(self) -> None:
        rate, duration = self.sample_rate, self.duration_s
        for name, holds, expected in (
            ("kind", self.kind in ("wav", "npy", "sio"), "wav, npy or sio"),
            ("path", isinstance(self.path, str) and bool(self.path), "the path of one file"),
            ("sample_rate", rate is None or 0 < rate < math.inf, "a positive number of Hz or null"),
            ("start_s", 0 <= self.start_s < math.inf, "a number from 0 up"),
            ("duration_s", duration is None or 0 < duration < math.inf, "a positive number or null"),
        ):
            require(holds, f"data.{name}", getattr(self, name), expected)


@dataclass
class TartSettings(DataSettings):
    """Visibilities of a TART radio array, see `torchdt.scenario.tart`.

    Attributes:
        kind: `tart`.
        path: of one file.
        average: consecutive covariances that make one step.
        standing: take out what stands still and is no sky, see `torchdt.scenario.tart_standing`.
        effective_count: snapshots that a covariance counts as; None takes it from the misfit of point
            sources, see `torchdt.scenario.tart_count`.
    """

    kind: str = "tart"
    average: int = 10
    standing: bool = True
    effective_count: float | None = None

    def __post_init__(self) -> None:
        count = self.effective_count
        for name, holds, expected in (
            ("kind", self.kind == "tart", "tart"),
            ("path", isinstance(self.path, str) and bool(self.path), "the path of one file"),
            ("average", self.average >= 1, "a positive integer"),
            ("effective_count", count is None or 1 <= count < math.inf, "a number from one up or null"),
        ):
            require(holds, f"data.{name}", getattr(self, name), expected)


@dataclass
class LoggingSettings:
    """What a run shows and writes beside its tables.

    Attributes:
        tensorboard: write event files.
        figures: write figures.
        surface_step: step whose estimates are drawn over the ambiguity surface.
        progress: show a progress bar on a terminal.
    """

    tensorboard: bool = True
    figures: bool = True
    surface_step: int = 200
    progress: bool = True

    def __post_init__(self) -> None:
        require(self.surface_step >= 0, "logging.surface_step", self.surface_step, "a step from 0 up")


@dataclass
class TrackSettings:
    """Settings of `experiments/track.py`.

    Attributes:
        tracker: settings of one of the trackers; their type says which.
        field: target and arguments of the array response, see `torchdt.field.build`.
        seed: of the first run; run b has `seed + b`.
        runs: sequences simulated and tracked in one batch; a recording brings its own number.
        variants: settings of the model for direct tracking, each a mapping of names in `Parameters`, and all
            of them used on every sequence with the same seeds. Runs count variant by variant.
        device, dtype: of the tracker.
        threads: of the linear algebra; None leaves them to PyTorch.
        workers: parts of the batch tracked at the same time, which share the threads; None makes one of each
            thread for batches of `MANY` sequences and more on a CPU.
        memory_gb: what tracking may take, 1e9 bytes; None allows half of what is free.
    """

    scenario: ScenarioSettings = dataclasses.field(default_factory=ScenarioSettings)
    field: Any = None
    calibration: CalibrationConfig = dataclasses.field(default_factory=CalibrationConfig)
    tracker: ObjectConfig = dataclasses.field(default_factory=ObjectConfig)
    data: DataSettings = dataclasses.field(default_factory=DataSettings)
    logging: LoggingSettings = dataclasses.field(default_factory=LoggingSettings)
    seed: int = 0
    runs: int = 1
    variants: list[Any] | None = None
    device: str = "cpu"
    dtype: str = "float32"
    threads: int | None = None
    workers: int | None = None
    memory_gb: float | None = None

    def __post_init__(self) -> None:
        require(self.runs >= 1, "runs", self.runs, "a positive integer")
        require(self.dtype in ("float32", "float64"), "dtype", self.dtype, "float32 or float64")
        require(_usable(self.device), "device", self.device, "a device that PyTorch can use here")
        for name in ("threads", "workers"):
            value = getattr(self, name)
            require(value is None or value >= 1, name, value, "a positive integer or null")
        enough = self.memory_gb is None or self.memory_gb > 0
        require(enough, "memory_gb", self.memory_gb, "a positive number or null")
        self.variant_configs()

    @property
    def torch_dtype(self) -> torch.dtype:
        """Real type of the tracker."""
        return torch.float32 if self.dtype == "float32" else torch.float64

    def variant_configs(self) -> list[TrackerConfig]:
        """Settings of the tracker for each of the variants; none where there are no variants.

        Raises:
            InputError: where a variant does not make sense, or the tracker is not the direct one.
        """
        return [] if self.variants is None else variant_configs(self.direct, self.variants)

    @property
    def direct(self) -> TrackerConfig:
        """The tracker's settings, for what only the direct tracker can do.

        Raises:
            InputError: where they are those of another tracker.
        """
        if not isinstance(self.tracker, TrackerConfig):
            raise InputError.of_key("tracker", type(self.tracker).__name__, "settings of direct tracking")
        return self.tracker


def _usable(device: str) -> bool:
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError):
        return False
    return True


def settings_of(config: DictConfig) -> TrackSettings:
    """Resolve and check a composed configuration.

    Raises:
        InputError: naming the key, the value found and what was expected.
    """
    _refuse_unknown(config, "")
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, TrackSettings)
    return settings


def _refuse_unknown(config: DictConfig, prefix: str) -> None:
    """Hydra's `+key=value` adds keys that no setting reads; converting the configuration would drop them."""
    schema = OmegaConf.get_type(config)
    known = {f.name for f in dataclasses.fields(schema)} if dataclasses.is_dataclass(schema) else None
    for key in config:
        name = f"{prefix}{key!s}"
        require(known is None or key in known, name, "an unknown key", f"one of {sorted(known or ())}")
        if not OmegaConf.is_missing(config, key) and isinstance(config[key], DictConfig):
            _refuse_unknown(config[key], f"{name}.")


_store = ConfigStore.instance()
_store.store(name="track_schema", node=TrackSettings)
_store.store(name="signal_schema", node=SignalSettings)
_store.store(name="tart_schema", node=TartSettings)
_store.store(name="direct_schema", node=TrackerConfig)
_store.store(name="mp_bp_schema", node=TwoStepConfig(detector=PursuitConfig()))
_store.store(name="sbl_bp_schema", node=TwoStepConfig(detector=SblConfig()))
