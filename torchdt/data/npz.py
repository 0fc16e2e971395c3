"""Recordings in NumPy's `.npz` format, without pickles.

Keys: `snapshots` or `covariance` with `num_snapshots`; `step_s`, and if need be `start_s` and `span_s`; and,
where a field or a score needs them, `freqs`, `element_depths`, `sensor_positions`, `truth`. `validate` says
what each must be.
"""

import logging
import math
import os
import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch
from numpy.lib.format import MAGIC_PREFIX, read_array_header_1_0, read_array_header_2_0, read_magic
from numpy.lib.npyio import NpzFile
from torch import Tensor

from torchdt.core.atomic import atomic_write
from torchdt.core.errors import InputError, require
from torchdt.core.files import regular_file
from torchdt.core.memory import free_memory_gb
from torchdt.data.recording import Recording, validate

log = logging.getLogger(__name__)

EXPECTED = "a complete .npz file"
HEADERS = {(1, 0): read_array_header_1_0, (2, 0): read_array_header_2_0}
KEYS = tuple(field.name for field in fields(Recording) if field.name != "name")


def read_npz(path: str | os.PathLike[str]) -> Recording:
    """Read and check one recording, or a batch of recordings of equal size.

    Args:
        path: the file; its stem becomes the name of the recording. Keys that mean nothing here are left
            out, with a warning in the log.

    Returns:
        The recording on the CPU. The data keep their precision, complex64 or complex128.

    Raises:
        InputError: no such file, not a complete `.npz`, or a key that does not fit.
    """
    path = Path(path)
    with open_file(path) as file, open_archive(path, file) as archive:
        unknown = sorted(set(archive.files) - set(KEYS))
        if unknown:
            log.warning("%s: keys without a meaning here are left out: %s", path, ", ".join(unknown))
        try:
            tensors = {key: read_tensor(key, archive) for key in KEYS if key in archive.files}
            recording = validate(**tensors, name=path.stem)
        except InputError as error:
            raise InputError(f"path '{path}': {error}") from error
    return recording


def write_npz(path: str | os.PathLike[str], recording: Recording) -> None:
    """Write a recording so that `read_npz` gives it back.

    Args:
        path: where to write, taken as it is: no extension is added. The folder must exist. The file appears
            only when it is complete.
        recording: what to write; its name is not stored, the file's name stands for it.
    """
    values = {key: getattr(recording, key) for key in KEYS}
    if (recording.start_s == recording.start_s[0]).all():
        values["start_s"] = recording.start_s[0]
    arrays = {key: np.asarray(_plain(value)) for key, value in values.items() if value is not None}
    with atomic_write(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def _plain(value: Tensor | float) -> np.ndarray | float:
    return value.detach().cpu().resolve_conj().numpy() if isinstance(value, Tensor) else value


def open_file(path: Path) -> BinaryIO:
    """Open a file to read; InputError where it cannot be."""
    try:
        return regular_file(path, EXPECTED).open("rb")
    except OSError as error:
        raise InputError.of_path(path, (error.strerror or str(error)).lower(), EXPECTED) from error


def open_archive(path: Path, file: BinaryIO) -> NpzFile:
    """The `.npz` archive in an open file; InputError where there is none."""
    is_array = file.read(len(MAGIC_PREFIX)) == MAGIC_PREFIX
    file.seek(0)
    if is_array:
        raise InputError.of_path(path, "a single array (.npy)", EXPECTED)
    try:
        archive = np.load(file, allow_pickle=False)
    except (ValueError, EOFError, OSError, NotImplementedError, zipfile.BadZipFile) as error:
        raise InputError.of_path(path, "a file of another kind, or part of one", EXPECTED) from error
    assert isinstance(archive, NpzFile)
    return archive


def read_tensor(key: str, archive: NpzFile) -> Tensor:
    """A numeric array of an archive, in its precision; InputError where it is none."""
    try:
        check_size(key, archive)
        array = archive[key]
    except InputError:
        raise
    except (ValueError, EOFError, OSError, RuntimeError, zlib.error, zipfile.BadZipFile) as error:
        raise InputError.of_key(key, f"an array that cannot be read ({error})", "a numeric array") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biufc":
        found = getattr(array, "dtype", type(array).__name__)
        raise InputError.of_key(key, found, "a numeric array")
    if array.dtype.itemsize > (16 if array.dtype.kind == "c" else 8):
        raise InputError.of_key(key, array.dtype, "double precision at most")
    # torch has only this machine's byte order, and few unsigned types.
    dtype = np.dtype("i8") if array.dtype.kind == "u" else array.dtype.newbyteorder("=")
    return torch.from_numpy(np.asarray(array, dtype=dtype, order="C"))


def check_size(key: str, archive: NpzFile) -> None:
    """Look at an array's header before anything of its size is made.

    Raises:
        InputError: where it claims more than the archive holds, or more than half of the memory that is free.
    """
    assert archive.zip is not None
    member = f"{key}.npy" if f"{key}.npy" in archive.zip.namelist() else key
    stored = archive.zip.getinfo(member).file_size
    with archive.zip.open(member) as file:
        read_header = HEADERS.get(read_magic(file))
        if read_header is None:
            return  # of a structured array, which is refused by its type
        shape, _, dtype = read_header(file)
        held = stored - file.tell()
    size, most = math.prod(shape) * dtype.itemsize, int(0.5e9 * free_memory_gb(torch.device("cpu")))
    require(dtype.hasobject or size <= held, key, f"a header of {size} bytes", f"{held}, as in the file")
    require(size <= most, key, f"{size} bytes", f"at most {most}, half of the memory that is free")
