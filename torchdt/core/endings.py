"""How a command ends where it cannot go on: one line that says why, and a status."""

import os
import sys
from typing import NoReturn

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def end(status: int, sentence: object) -> NoReturn:
    """Say one line on standard error, and end the program."""
    sys.stderr.write(f"{sentence}\n")
    sys.exit(status)


def wants_traceback() -> bool:
    """Whether whoever looks for a fault has asked for all of it, by Hydra's `HYDRA_FULL_ERROR=1`."""
    return os.environ.get("HYDRA_FULL_ERROR") == "1"
