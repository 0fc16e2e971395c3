"""Jobs that go on in the directory of an interrupted run, and leave that of a finished one alone."""

import dataclasses
import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from torchdt.app.settings import TrackSettings
from torchdt.core.errors import InputError
from torchdt.core.files import regular_file
from torchdt.run.checkpoint import flatten, load_checkpoint, require_like, save_checkpoint
from torchdt.run.keeper import Keeper

NEUTRAL = ("logging", "threads", "workers", "memory_gb", "checkpoint_s")
"""Settings on which no number depends; a run that goes on keeps its chunks."""

KIND = "track"


def fingerprint_of(settings: TrackSettings, files: Iterable[str] = ()) -> dict[str, object]:
    """Plain values by dotted names of all that a job's numbers depend on, contents of its files among them.

    Args:
        settings: of the job.
        files: that it reads beside those of its data and field.
    """
    plain = {key: value for key, value in dataclasses.asdict(settings).items() if key not in NEUTRAL}
    data, field = settings.data, settings.field
    environment = field.get("env_file") if isinstance(field, Mapping) else None
    paths = [path for path in (*data.paths, getattr(data, "truth", None), environment, *files) if path]
    return {**flatten(plain), **{f"content of {path}": _digest(path) for path in paths}}


def _digest(path: str) -> str:
    try:
        with regular_file(path, "a file").open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, InputError):
        return "no file"  # of which whoever reads it will complain


class RunCheckpoint:
    """`checkpoint.pt` of a tracking run: what it is, whether it is finished, and its score.

    Args:
        directory: of the run. While it goes on, the state of tracking is in `checkpoint/`.
        fingerprint: of the run.
        every_s: seconds between writing the state; None keeps nothing of a run that starts here.

    Raises:
        InputError: where the directory holds the checkpoint of another run, or a damaged one.
    """

    def __init__(self, directory: Path, fingerprint: dict[str, object], every_s: float | None) -> None:
        self.path, self.folder = directory / "checkpoint.pt", directory / "checkpoint"
        self.fingerprint, self.every_s = fingerprint, every_s
        self._known = load_checkpoint(self.path, KIND, fingerprint)
        if self._known is not None:
            require_like(self.path, self._known, {"finished": bool, "score": float | None})

    @property
    def finished(self) -> bool:
        """Whether all results are written."""
        return self._known is not None and self._known["finished"]

    @property
    def score(self) -> float | None:
        """What the finished run returned."""
        return None if self._known is None else self._known["score"]

    def keeper(self, before: Callable[[], None]) -> Keeper | None:
        """What keeps the state of tracking, see `torchdt.run.keeper.Keeper`; None where nothing is kept."""
        if self.every_s is None and self._known is None:
            return None
        self._save(finished=False, score=None)
        every_s = math.inf if self.every_s is None else self.every_s
        return Keeper(self.folder, self.fingerprint, every_s, before)

    def finish(self, score: float | None, keeper: Keeper) -> None:
        """Mark the run as finished; the state of tracking is no longer needed."""
        self._save(finished=True, score=score)
        keeper.clear()

    def _save(self, **content: object) -> None:
        save_checkpoint(self.path, KIND, self.fingerprint, content)
