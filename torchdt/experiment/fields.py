"""Fields from settings."""

from typing import Any

import torch
from hydra.utils import instantiate

from torchdt.errors import InputError
from torchdt.field.base import Field


def build_field(target: dict[str, Any], dtype: torch.dtype, device: str, **overrides: object) -> Field:
    """Instantiate a field from its configuration group.

    Raises:
        InputError: where the target does not exist or does not take these arguments.
    """
    try:
        field = instantiate({**target, **overrides}, dtype=dtype, device=device, _convert_="all")
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
    return field
