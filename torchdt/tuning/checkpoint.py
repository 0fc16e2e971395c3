"""Tuning runs that survive the end of their process."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path

import torch

from torchdt.atomic import atomic_write
from torchdt.errors import InputError
from torchdt.tuning.state import Record, TuningState

EXPECTED = "a complete checkpoint of a tuning run"


def save_checkpoint(
    path: str | os.PathLike[str], state: TuningState, fingerprint: Mapping[str, object]
) -> None:
    """Write a state so that `load_checkpoint` gives it back; the file is complete or absent.

    Args:
        path: where to write; the folder must exist.
        state: of the run.
        fingerprint: plain values by name, of all that the run depends on.
    """
    content = {"fingerprint": dict(fingerprint), "state": dataclasses.asdict(state)}
    with atomic_write(path) as file:
        torch.save(content, file)


def load_checkpoint(path: str | os.PathLike[str], fingerprint: Mapping[str, object]) -> TuningState | None:
    """Read a state; None where there is no file.

    Args:
        path: the file.
        fingerprint: of the run that is to go on.

    Raises:
        InputError: where the file is not a complete checkpoint, or one of a run with another fingerprint.
    """
    path = Path(path)
    if not path.exists():
        return None
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        known, fields = dict(content)["fingerprint"], content["state"]
        records = tuple(Record(**record) for record in fields["records"])
        state = TuningState(**{**fields, "records": records})
    except Exception as error:  # a damaged file raises whatever its bytes happen to mean
        raise InputError.of_path(path, "a file of another kind, or part of one", EXPECTED) from error
    for key in {**known, **fingerprint}:
        now, then = fingerprint.get(key, "nothing"), known.get(key, "nothing")
        if now != then:
            raise InputError.of_key(key, now, f"{then}, as in {path}; another folder starts anew")
    return state


def flatten(config: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Plain values of nested mappings by dotted names."""
    flat: dict[str, object] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        flat.update(flatten(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value})
    return flat
