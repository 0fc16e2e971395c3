"""What a job has done, in a file from which only the same job goes on."""

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from torchdt.atomic import atomic_write
from torchdt.errors import InputError


def save_checkpoint(
    path: str | os.PathLike[str], kind: str, fingerprint: Mapping[str, object], content: Mapping[str, object]
) -> None:
    """Write what a job has done so that `load_checkpoint` gives it back; the file is complete or absent.

    Args:
        path: where to write; the folder must exist.
        kind: of the job, such as `track`.
        fingerprint: plain values by name, of all that the job's numbers depend on.
        content: by name, nested dictionaries, lists and tuples of plain values and tensors of any device.

    Raises:
        StorageError: where the file cannot be written; one that was there before stays.
    """
    buffer = io.BytesIO()  # PyTorch, writing a file itself, hides why it cannot
    torch.save({"kind": kind, "fingerprint": dict(fingerprint), "content": dict(content)}, buffer)
    with atomic_write(path) as file:
        file.write(buffer.getbuffer())


def load_checkpoint(
    path: str | os.PathLike[str], kind: str, fingerprint: Mapping[str, object]
) -> dict[str, Any] | None:
    """Content of a checkpoint, its tensors on the CPU; None where there is no file.

    Args:
        path: the file. No code in it is run.
        kind: of the job that is to go on.
        fingerprint: of that job.

    Raises:
        InputError: where the file is not a complete checkpoint, or that of a job of another kind, or of one
            with another fingerprint: naming the first key that differs.
    """
    path = Path(path)
    if not path.exists():
        return None
    try:
        stored = dict(torch.load(path, map_location="cpu", weights_only=True))
        found, known, content = stored["kind"], dict(stored["fingerprint"]), dict(stored["content"])
    except Exception as error:  # a damaged file raises whatever its bytes happen to mean
        raise not_a_checkpoint(path, kind) from error
    if found != kind:
        raise InputError.of_path(
            path, f"a checkpoint of '{found}'", f"one of '{kind}'; another folder starts anew"
        )
    for key in {**known, **fingerprint}:
        now, then = fingerprint.get(key, "nothing"), known.get(key, "nothing")
        if now != then:
            raise InputError.of_key(key, now, f"{then}, as in {path}; another folder starts anew")
    return content


def not_a_checkpoint(path: str | os.PathLike[str], kind: str) -> InputError:
    """The error of a file that does not hold what a checkpoint of this kind does."""
    return InputError.of_path(
        path, "a file of another kind, or part of one", f"a complete checkpoint of '{kind}'"
    )


def flatten(config: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Plain values of nested mappings by dotted names."""
    flat: dict[str, object] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        flat.update(flatten(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value})
    return flat
