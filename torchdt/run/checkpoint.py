"""What a job has done, in a file from which only the same job goes on."""

import io
import os
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Any

import torch
from torch import Tensor

from torchdt.core.atomic import atomic_write
from torchdt.core.errors import InputError


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


def require_like(
    path: str | os.PathLike[str], found: object, expected: object, place: str = "content"
) -> None:
    """Check that what a checkpoint holds is made as its job makes it, for no later step to stumble.

    Args:
        path: of the file, for the error.
        found: from the file.
        expected: a tensor stands for those of its shape and type; a type, or a union of some, for its values;
            a mapping for those with the same keys, a list or tuple for those of
            the same length, each entry like its own.
        place: of `found` in the file.

    Raises:
        InputError: naming the file, the first place that differs, and what is there.
    """
    if isinstance(expected, Mapping):
        same = isinstance(found, Mapping) and found.keys() == expected.keys()
        words = f"the keys {', '.join(map(str, expected))}"
        parts = [(key, expected[key]) for key in expected]
    elif isinstance(expected, list | tuple):
        same = isinstance(found, list | tuple) and len(found) == len(expected)
        words = f"{len(expected)} entries"
        parts = list(enumerate(expected))
    elif isinstance(expected, Tensor):
        same = isinstance(found, Tensor) and (found.shape, found.dtype) == (expected.shape, expected.dtype)
        words, parts = _words(expected), []
    else:
        assert isinstance(expected, type | UnionType)
        same = isinstance(found, expected) and not (
            isinstance(found, bool) and expected not in (bool, object)
        )
        words, parts = getattr(expected, "__name__", str(expected)), []
    if not same:
        raise InputError.of_path(path, f"{place}: {_words(found)}", f"{words}; another folder starts anew")
    for key, part in parts:
        require_like(path, found[key], part, f"{place}.{key}")  # type: ignore[index]


def _words(found: object) -> str:
    """What there is, in words that are short whatever it is."""
    if isinstance(found, Tensor):
        return f"a tensor {tuple(found.shape)} of {str(found.dtype).removeprefix('torch.')}"
    if isinstance(found, Mapping):
        return f"the keys {', '.join(map(str, found))}"[:200]
    if isinstance(found, list | tuple):
        return f"{len(found)} entries"
    return f"{found!r}"[:200]


def flatten(config: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Plain values of nested mappings by dotted names."""
    flat: dict[str, object] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        flat.update(flatten(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value})
    return flat
