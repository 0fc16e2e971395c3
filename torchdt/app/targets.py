"""Objects from settings that name their class: the field, and the parts of the model."""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

import torch
from hydra.utils import instantiate

from torchdt.core.errors import InputError, require
from torchdt.field.base import BaseField, Field, as_field
from torchdt.filter.config import PARTS, ObjectConfig
from torchdt.model.birth import Birth
from torchdt.model.model import Model
from torchdt.model.motion.base import Motion
from torchdt.model.noise.base import NoiseModel
from torchdt.model.power.base import PowerModel

PROTOCOLS = {"motion": Motion, "power": PowerModel, "noise": NoiseModel, "birth": Birth}

Config = TypeVar("Config", bound=ObjectConfig)


def build_field(target: dict[str, Any], dtype: torch.dtype, device: str, **overrides: object) -> BaseField:
    """Instantiate a field from its configuration group.

    Raises:
        InputError: see `build`.
    """
    return as_field(build("field", target, Field, **overrides, dtype=dtype, device=device))


def build_model(settings: Mapping[str, Any]) -> Model:
    """Instantiate the statistical model from its group; parts that it does not name are the default.

    Raises:
        InputError: where a part is not one, see `build`; where a key is unknown, or a number out of range.
    """
    known = {*PROTOCOLS, *Model().quantities()}
    for name in settings:
        require(name in known, f"model.{name}", "an unknown key", f"one of {sorted(known)}")
    chosen = {name: kind for name, kind in PROTOCOLS.items() if name in settings}
    parts = {name: build(f"model.{name}", settings[name], kind) for name, kind in chosen.items()}
    return Model(**{**settings, **parts})


def build_config(settings: Config) -> Config:
    """Settings of a tracker, with its parts instantiated from their groups; None is the default.

    Raises:
        InputError: where a part is not one, see `build`.
    """
    parts = {name: getattr(settings, name) for name in settings.part_names()}
    chosen = {name: part for name, part in parts.items() if part is not None}
    built = {
        name: part if isinstance(part, PARTS[name]) else build(f"tracker.{name}", part, PARTS[name])
        for name, part in chosen.items()
    }
    default = type(settings)()
    return dataclasses.replace(settings, **{name: built.get(name, getattr(default, name)) for name in parts})


def without_parts(settings: Config) -> Config:
    """Settings whose parts are None, for configuration groups to fill in."""
    nothing: dict[str, Any] = dict.fromkeys(settings.part_names())
    return dataclasses.replace(settings, **nothing)


def build(key: str, target: Any, kind: Any, **overrides: object) -> Any:
    """Instantiate one object. The one function that is called is that of its own `_target_`.

    Args:
        key: of the settings, for messages.
        target: settings: `_target_`, and arguments by name.
        kind: protocol that the object must follow.
        overrides: further arguments.

    Raises:
        InputError: where the target does not exist, does not take these arguments or makes something else, or
            where there is another `_target_` among the arguments.
    """
    if not isinstance(target, Mapping):
        raise InputError.of_key(key, target, f"a choice of the group {key.replace('.', '/')}")
    require("_target_" in target, f"{key}._target_", "nothing", "the name of a class")
    for name, value in target.items():
        _refuse_targets(key, f"{key}.{name}", value)
    try:
        made = instantiate({**target, **overrides}, _convert_="all", _recursive_=False)
    except InputError:
        raise
    except Exception as error:
        # Hydra wraps what a target raises; the cause says what is wrong with the input.
        cause = error.__cause__
        raise cause if isinstance(cause, InputError) else InputError(f"key '{key}': {error}") from error
    if not isinstance(made, kind):
        expected = f"an object that follows {kind.__module__}.{kind.__name__}"
        raise InputError.of_key(f"{key}._target_", type(made).__name__, expected)
    return made


def _refuse_targets(owner: str, key: str, value: object) -> None:
    """Refuse `_target_` in nested values: data are no place for calls."""
    if isinstance(value, Mapping):
        expected = f"none but {owner}._target_"
        require("_target_" not in value, f"{key}._target_", value.get("_target_"), expected)
        for name, entry in value.items():
            _refuse_targets(owner, f"{key}.{name}", entry)
    elif isinstance(value, list | tuple):
        for index, entry in enumerate(value):
            _refuse_targets(owner, f"{key}[{index}]", entry)
