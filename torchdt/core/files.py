"""The check that every file passes before it is read."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

from torchdt.core.errors import InputError


def regular_file(
    path: str | os.PathLike[str],
    expected: object,
    refuse: Callable[[object, object, object], InputError] = InputError.of_path,
) -> Path:
    """A path behind which there is a file that can be read to its end: no folder, pipe or device.

    Args:
        path: what was given.
        expected: what it should be, in words.
        refuse: makes the error of a path, of what was found and of what was expected.

    Raises:
        InputError: where the name cannot be that of a file, or what bears it is none.
    """
    name = os.fspath(path)
    try:
        name.encode()  # results and messages name the file in UTF-8
        mode = os.stat(name).st_mode
    except ValueError as error:
        raise refuse(ascii(name), "a name with NUL or with bytes that are no UTF-8", expected) from error
    except OSError as error:
        raise refuse(path, (error.strerror or str(error)).lower(), expected) from error
    if not stat.S_ISREG(mode):
        raise refuse(path, "a folder" if stat.S_ISDIR(mode) else "a pipe, a socket or a device", expected)
    return Path(name)
