"""Run directories that belong to one process: names that do not meet, and a claim before Hydra writes."""

import os
import secrets
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from torchdt.core.atomic import check_writable
from torchdt.core.endings import end, wants_traceback
from torchdt.core.errors import InputError, StorageError
from torchdt.core.ranges import Name, fault
from torchdt.run.claim import InUseError, claim, refuse_claimed, release

RUN, SWEEP = ".run.lock", ".sweep.lock"

# `${unique:}`: eight hexadecimal digits that tell apart what was started in the same second.
OmegaConf.register_new_resolver("unique", lambda: secrets.token_hex(4), use_cache=True, replace=True)


def claim_run(directory: str | os.PathLike[str]) -> None:
    """Claim the directory of a run or of one job of a sweep, see `torchdt.run.claim.claim`."""
    claim(directory, RUN)


def release_run(directory: str | os.PathLike[str]) -> None:
    """Give back what `claim_run` has claimed."""
    release(directory, RUN)


def run_directory() -> Path:
    """Hydra's directory of the job that is running, claimed where no callback has done so.

    Raises:
        InUseError: where another process works there.
    """
    directory = Path(HydraConfig.get().runtime.output_dir)
    claim_run(directory)
    return directory


class DirectoryClaims(Callback):
    """Hydra's callback that claims the directory of a run or a sweep before Hydra writes into it.

    A run is refused below a sweep that another process works on, and a sweep where one works on anything
    below it: then the process ends with status 1 and a line that says who does. Jobs of a sweep claim their
    own directories, see `SweepReport`.
    """

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Claim the directory of a single run, of whose path the names in the configuration may be a part."""
        for key in ("name", "scenario.name"):
            name = OmegaConf.select(config, key)
            expected = None if name is None else fault(Name, str(name))
            if expected is not None:
                end(1, InputError.of_key(key, name, expected))
        _claim(Path(config.hydra.run.dir), RUN)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Claim the directory of a sweep."""
        _claim(Path(config.hydra.sweep.dir), SWEEP)


def _claim(directory: Path, name: str) -> None:
    """First the claim, then the look around: of two that start at once, one sees the other at least."""
    try:
        check_writable(directory)
        claim(directory, name)
        around = [parent / SWEEP for parent in directory.resolve().parents]
        if name == SWEEP:
            around += [path for kind in (RUN, SWEEP) for path in directory.rglob(kind)]
        for path in around:
            refuse_claimed(path)
    except InUseError as error:
        end(1, error)
    except StorageError as error:
        if not wants_traceback():  # else it is Hydra's turn to find out
            end(1, error)
