"""Configuration of tuning: schema for Hydra, checks at the edge."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hydra.core.config_store import ConfigStore

from torchdt.app.settings import TrackSettings
from torchdt.core.errors import require
from torchdt.core.ranges import Seed
from torchdt.model.hyperparameters import HyperparameterSettings, PriorSettings
from torchdt.tuning.config import TuningConfig


@dataclass
class TuneSettings(TrackSettings):
    """Settings of `experiments/tune.py`, beside those of `experiments/track.py`.

    Attributes:
        hyperparameters: `HyperparameterSettings` by name, or the values of their configuration.
        tuning: how.
        train_seeds, heldout_seeds: of simulated sequences; `runs` and, here, `seed` do not matter.
        train_paths, heldout_paths: files instead; give both or none. They are of the kind that `data` says,
            `.npz` where it is simulated, and stand in for `data.path`. The filter's seeds count from `seed`.
        pad: let sequences have different lengths.
    """

    # Hydra cannot add entries to a dictionary whose values have a schema: these are checked here instead.
    hyperparameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    tuning: TuningConfig = dataclasses.field(default_factory=TuningConfig)
    train_seeds: list[Seed] = dataclasses.field(default_factory=list)
    heldout_seeds: list[Seed] = dataclasses.field(default_factory=list)
    train_paths: list[str] = dataclasses.field(default_factory=list)
    heldout_paths: list[str] = dataclasses.field(default_factory=list)
    pad: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self.hyperparameters = {
            name: _checked(f"hyperparameters.{name}", value, HyperparameterSettings)
            for name, value in self.hyperparameters.items()
        }
        known = self.data.kind == "simulated" or bool(self.train_paths)
        require(known, "data", self.data.kind, "its files as train_paths and heldout_paths")
        require(
            self.variants is None, "variants", self.variants, "null: the search tries settings of its own"
        )
        both = bool(self.train_paths) == bool(self.heldout_paths)
        require(both, "heldout_paths", self.heldout_paths, "files for both sets or for none")
        kind = "paths" if self.train_paths else "seeds"
        train, heldout = (list(getattr(self, f"{name}_{kind}")) for name in ("train", "heldout"))
        for key, entries in ((f"train_{kind}", train), (f"heldout_{kind}", heldout)):
            require(len(set(entries)) == len(entries) > 0, key, entries, "at least one, each once")
        shared = [entry for entry in heldout if entry in train]
        expected = f"none of those in train_{kind}"
        require(not shared, f"heldout_{kind}", f"{shared} in both sets", expected)


def _checked(key: str, value: object, kind: type) -> Any:
    """Settings from the mapping of a configuration."""
    if isinstance(value, kind):
        return value
    names = [field.name for field in dataclasses.fields(kind)]
    require(isinstance(value, Mapping), key, value, f"some of {names} by name")
    assert isinstance(value, Mapping)
    for name in value:
        require(name in names, f"{key}.{name}", "an unknown key", f"one of {names}")
    values = dict(value)
    if kind is HyperparameterSettings:
        trainable = values.get("trainable", True)
        require(isinstance(trainable, bool), f"{key}.trainable", trainable, "true or false")
        if values.get("prior") is not None:
            values["prior"] = _checked(f"{key}.prior", values["prior"], PriorSettings)
    else:
        require(set(names) == set(values), key, sorted(values), f"both of {names}")
        number = isinstance(values["spread"], int | float)
        require(number, f"{key}.spread", values["spread"], "a positive number")
    return kind(**values)


ConfigStore.instance().store(name="tune_schema", node=TuneSettings)
