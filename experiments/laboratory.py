"""Jobs of these scripts: the package's, and those of the folders beside this file, which no wheel holds.

Their configuration is in `conf/`, beside that of the package; jobs of the package find it, too.
"""

import os
from collections.abc import Callable
from pathlib import Path

# Kinds of data, for all jobs.
import recordings.directions
import recordings.tart_recording  # noqa: F401
from torchdt.app import job as jobs

FOLDER = Path(__file__).parent
CONF = FOLDER / "conf"


def job(name: str, package: str = "torchdt.app") -> Callable[[], None]:
    """The command line of a job, see `torchdt.app.job.job`."""
    # The processes that a launcher starts must find the folders, too.
    path = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if str(FOLDER) not in path:
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(FOLDER), *path]))
    return jobs.job(name, package, CONF)
