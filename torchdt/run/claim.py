"""Folders that one process at a time works in."""

import errno
import fcntl
import logging
import os
import platform
from pathlib import Path
from typing import BinaryIO, Self

from torchdt.core.atomic import storing
from torchdt.core.errors import InputError

UNSUPPORTED = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)
"""What a file system answers that has no locks."""

log = logging.getLogger(__name__)

_held: dict[Path, BinaryIO] = {}  # by this process


class InUseError(InputError):
    """A folder in which another process works."""

    @classmethod
    def of_claim(cls, path: Path, file: BinaryIO) -> Self:
        """Build the error of a claim, whose open file holds what its holder says of itself."""
        file.seek(0)
        holder = file.read().decode(errors="replace").strip() or "another process"
        return cls.of_path(path.parent, f"{holder} at work there", "its end, or another folder")


def claim(folder: str | os.PathLike[str], name: str) -> None:
    """Keep other processes that claim the same out of a folder, until `release` or the end of this process.

    The claim is a lock on a hidden file, which the operating system drops however the process ends: a claim
    never outlives its holder, although the file of one that was killed does. A claim that this process has it
    keeps. On a file system without locks there is a warning, and nothing is kept out.

    Args:
        folder: made if absent.
        name: of the hidden file; claims of other names do not meet.

    Raises:
        InUseError: where another process has it.
        StorageError: where the file cannot be made.
    """
    path = Path(folder).resolve() / name
    while path not in _held:
        with storing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            file = open(path, "a+b")  # noqa: SIM115, open as long as the claim lasts
        if not _lock(file, fcntl.LOCK_EX):
            with file:
                raise InUseError.of_claim(path, file)
        if not _is_at(path, file):  # whoever had it took the file away after it was opened here
            file.close()
            continue
        with storing(path):
            file.truncate(0)
            file.write(f"process {os.getpid()} of {platform.node()}\n".encode())
            file.flush()
        _held[path] = file


def release(folder: str | os.PathLike[str], name: str) -> None:
    """Give a claim back and take its file away; nothing where this process does not have it."""
    path = Path(folder).resolve() / name
    file = _held.pop(path, None)
    if file is not None:
        path.unlink(missing_ok=True)  # while it is locked: the next one makes its own
        file.close()


def release_all() -> None:
    """Give back all claims of this process."""
    for path in list(_held):
        release(path.parent, path.name)


def refuse_claimed(path: Path) -> None:
    """Check that no other process has the claim whose hidden file this is.

    Raises:
        InUseError: where one has it.
    """
    path = path.resolve()
    try:
        file = open(path, "rb")  # noqa: SIM115
    except OSError:
        return  # no such claim, or none that concerns this user
    with file:
        if path not in _held and not _lock(file, fcntl.LOCK_SH):
            raise InUseError.of_claim(path, file)


def _lock(file: BinaryIO, kind: int) -> bool:
    """Lock an open file until it is closed; False where another process has it."""
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
        log.warning("%s: this file system has no locks, nothing keeps a second process out", file.name)
    return True


def _is_at(path: Path, file: BinaryIO) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False
