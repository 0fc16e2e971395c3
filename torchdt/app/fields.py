"""Fields from settings."""

from collections.abc import Mapping
from typing import Any

import torch
from hydra.utils import instantiate

from torchdt.core.errors import InputError, require
from torchdt.field.base import BaseField, Field, as_field


def build_field(target: dict[str, Any], dtype: torch.dtype, device: str, **overrides: object) -> BaseField:
    """Instantiate a field from its configuration group.

    The one function that is called is that of the group's own `_target_`.

    Raises:
        InputError: where the target does not exist or does not take these arguments, or where there is
            another `_target_` among them.
    """
    for key, value in target.items():
        _refuse_targets(f"field.{key}", value)
    keywords = {"dtype": dtype, "device": device, "_convert_": "all", "_recursive_": False}
    try:
        field = instantiate({**target, **overrides}, **keywords)
    except InputError:
        raise
    except Exception as error:
        # Hydra wraps what a target raises; the cause says what is wrong with the input.
        cause = error.__cause__
        raise cause if isinstance(cause, InputError) else InputError(f"key 'field': {error}") from error
    if not isinstance(field, Field):
        raise InputError.of_key(
            "field._target_", type(field).__name__, "an object that follows torchdt.field.Field"
        )
    return as_field(field)


def _refuse_targets(key: str, value: object) -> None:
    """Refuse `_target_` in nested values: data are no place for calls."""
    if isinstance(value, Mapping):
        require("_target_" not in value, f"{key}._target_", value.get("_target_"), "none but field._target_")
        for name, entry in value.items():
            _refuse_targets(f"{key}.{name}", entry)
    elif isinstance(value, list | tuple):
        for index, entry in enumerate(value):
            _refuse_targets(f"{key}[{index}]", entry)
