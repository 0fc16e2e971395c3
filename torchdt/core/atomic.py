"""Files that are either complete or absent, and errors that say why one could not be written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

from torchdt.core.errors import StorageError

PROBE = 1 << 16
"""More than a job's configuration and the first lines of its log, bytes."""


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that takes its place only when the block ends without error.

    Args:
        path: where the file goes; its folder must exist. A file already there is replaced.

    Yields:
        The open binary file.

    Raises:
        StorageError: where it cannot be written; what was there before stays.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with storing(path):
        try:
            with open(temporary, "wb") as file:
                yield file
                # Some storage says only now that it is full; and a name must not come before its content.
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            with suppress(OSError):  # or it would hide the first error
                temporary.unlink(missing_ok=True)


@contextmanager
def storing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Whatever the operating system refuses in the block becomes a `StorageError` of this file or folder."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        raise StorageError.of_path(path, error) from error


def check_writable(directory: str | os.PathLike[str]) -> None:
    """Make a folder, if absent, and see that it takes `PROBE` bytes, of which nothing stays.

    Raises:
        StorageError: where it does not.
    """
    with storing(directory):
        Path(directory).mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=directory) as file:
            file.write(bytes(PROBE))
            file.flush()
            os.fsync(file.fileno())
