"""Storage that fails."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest import mock

from torchdt import atomic


@contextmanager
def full_disk(fills: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """What is written file by file goes to a device without space, from when `fills` says so."""

    def opened(path, mode):
        return open("/dev/full" if fills() else path, mode)

    with mock.patch.object(atomic, "open", opened, create=True):
        yield
