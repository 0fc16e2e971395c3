"""Storage that fails."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from tempfile import TemporaryFile
from unittest import mock

from torchdt.core import atomic


@contextmanager
def full_disk(fills: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """What is written file by file goes to a device without space, from when `fills` says so."""

    def opened(path, mode):
        return open("/dev/full" if fills() else path, mode)

    def temporary(dir):
        return open("/dev/full", "wb") if fills() else TemporaryFile(dir=dir)

    probe = mock.patch.object(atomic, "TemporaryFile", temporary)
    with mock.patch.object(atomic, "open", opened, create=True), probe:
        yield
