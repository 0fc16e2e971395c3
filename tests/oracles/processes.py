"""Other processes at work in a folder."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def at_work(folder: Path, name: str) -> Iterator[None]:
    """A claim that is not this process's own: locks belong to open files, whoever opens them."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / name, "w") as file:
        file.write("process 1 of elsewhere\n")
        file.flush()
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
        (folder / name).unlink()
