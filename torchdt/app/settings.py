"""Configuration of the experiments: schemas for Hydra, range checks at the edge."""

import dataclasses
import functools
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from torchdt.app.data_settings import DataSettings, SignalSettings
from torchdt.app.targets import build_config, build_model, without_parts
from torchdt.baselines.detect.config import PursuitConfig, SblConfig
from torchdt.baselines.two_step import TwoStepConfig
from torchdt.calibration.environment import CalibrationConfig
from torchdt.core.errors import InputError, require
from torchdt.core.ranges import Checked, Count, OneOf, Positive, Seed, StepIndex, Steps, Threads
from torchdt.filter.config import ObjectConfig, TrackerConfig
from torchdt.filter.paper.config import PaperConfig
from torchdt.model.model import Model
from torchdt.run.variants import variant_models
from torchdt.simulation.settings import ScenarioSettings

MANY = 8
"""Sequences from which on threads track chunks of a batch, instead of sharing each operation."""


@dataclass
class LoggingSettings(Checked):
    """What a run shows and writes beside its tables.

    Attributes:
        tensorboard: write event files.
        interval: steps from one histogram of beliefs and picture of particles in the event files to the
            next; None writes none.
        figures: write figures.
        surface_step: step whose estimates are drawn over the ambiguity surface.
        progress: show a progress bar on a terminal.
    """

    KEY: ClassVar[str] = "logging"

    tensorboard: bool = True
    interval: Steps | None = 50
    figures: bool = True
    surface_step: StepIndex = 200
    progress: bool = True


@dataclass
class TrackSettings(Checked):
    """Settings of `experiments/track.py`.

    Attributes:
        tracker: settings of one of the trackers; their type says which.
        field: target and arguments of the array response, see `torchdt.field.build`.
        seed: of the first run; run b has `seed + b`.
        runs: sequences simulated and tracked in one batch; a recording brings its own number.
        model: targets and numbers of the statistical model, see `torchdt.model.model.Model`.
        variants: settings of the model for direct tracking, each a mapping of its numbers by name, and all of
            them used on every sequence with the same seeds. Runs count variant by variant.
        device, dtype: of the tracker.
        threads: of the linear algebra; None leaves them to PyTorch.
        workers: parts of the batch tracked at the same time, which share the threads; None makes one of each
            thread for batches of `MANY` sequences and more on a CPU.
        memory_gb: what tracking may take, 1e9 bytes; None allows half of what is free.
        checkpoint_s: seconds between writing how far `experiments/track.py` has come, to go on from there;
            None writes nothing.
    """

    scenario: ScenarioSettings = dataclasses.field(default_factory=ScenarioSettings)
    field: Any = None
    calibration: CalibrationConfig = dataclasses.field(default_factory=CalibrationConfig)
    model: Any = dataclasses.field(default_factory=dict)
    tracker: ObjectConfig = dataclasses.field(default_factory=lambda: without_parts(ObjectConfig()))
    data: DataSettings = dataclasses.field(default_factory=DataSettings)
    logging: LoggingSettings = dataclasses.field(default_factory=LoggingSettings)
    seed: Seed = 0
    runs: Count = 1
    variants: list[Any] | None = None
    device: str = "cpu"
    dtype: Annotated[str, OneOf(("float32", "float64"))] = "float32"
    threads: Threads | None = None
    workers: Threads | None = None
    memory_gb: Positive | None = None
    checkpoint_s: Positive | None = 15.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(_usable(self.device), "device", self.device, "a device that PyTorch can use here")
        self.variant_models()
        _ = self.built_tracker

    @property
    def torch_dtype(self) -> torch.dtype:
        """Real type of the tracker."""
        return torch.float32 if self.dtype == "float32" else torch.float64

    @functools.cached_property
    def statistical_model(self) -> Model:
        """What the trackers assume.

        Raises:
            InputError: where a part or a number does not make sense.
        """
        return build_model(self.model)

    @functools.cached_property
    def built_tracker(self) -> ObjectConfig:
        """The tracker's settings with its parts as objects.

        Raises:
            InputError: where a part does not make sense.
        """
        return build_config(self.tracker)

    def variant_models(self) -> list[Model]:
        """The model of each of the variants; none where there are no variants.

        Raises:
            InputError: where a variant does not make sense, or the tracker is not the direct one.
        """
        model = self.statistical_model
        if self.variants is None:
            return []
        _ = self.direct
        return variant_models(model, self.variants)

    @property
    def direct(self) -> TrackerConfig:
        """The tracker's settings, for what only the direct tracker can do.

        Raises:
            InputError: where they are those of another tracker.
        """
        if not isinstance(self.built_tracker, TrackerConfig):
            raise InputError.of_key("tracker", type(self.tracker).__name__, "settings of direct tracking")
        return self.built_tracker


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
_store.store(name="direct_schema", node=without_parts(TrackerConfig()))
_store.store(name="direct_paper_schema", node=without_parts(PaperConfig()))
_store.store(name="mp_bp_schema", node=without_parts(TwoStepConfig(detector=PursuitConfig())))
_store.store(name="sbl_bp_schema", node=without_parts(TwoStepConfig(detector=SblConfig())))
