"""Tracking that survives the end of its process: what each chunk of sequences has done, in a folder."""

import logging
import math
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from torchdt.core.atomic import storing
from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.filter.history import StepEstimate, TrackHistory
from torchdt.filter.tracker import Past
from torchdt.run.checkpoint import load_checkpoint, require_like, save_checkpoint

KIND = "tracking"

log = logging.getLogger(__name__)


class Keeper:
    """Keeps what tracking has done, so that another process goes on from there with the same numbers.

    The folder holds `plan.pt`, the chunks, and for each chunk `<first>-<last>.pt`: state, random numbers and
    estimates up to its last kept step.

    Args:
        directory: the folder, made when there is something to keep.
        fingerprint: plain values by name, of all that the estimates depend on.
        every_s: seconds from one writing to the next; they decide when, never what. The last step of a chunk
            is always kept.
        before: called before each writing, to bring to the disk what belongs to the steps so far.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str],
        fingerprint: Mapping[str, object],
        every_s: float = math.inf,
        before: Callable[[], None] = lambda: None,
    ) -> None:
        self.directory, self.fingerprint = Path(directory), dict(fingerprint)
        self.every_s, self.before = every_s, before
        self._start, self._earlier = time.perf_counter(), 0.0

    @property
    def seconds(self) -> float:
        """What tracking has taken, in this process and up to what it went on from."""
        return self._earlier + time.perf_counter() - self._start

    def plan(self, chunks: Sequence[slice]) -> list[slice]:
        """The chunks that were kept; where there are none, these are from now on.

        Raises:
            InputError: where the folder is that of another fingerprint, or damaged.
            StorageError: where it cannot be written.
        """
        path = self.directory / "plan.pt"
        known = load_checkpoint(path, KIND, self.fingerprint)
        if known is not None:
            return _chunks_in(path, known, chunks[-1].stop)
        with storing(self.directory):
            self.directory.mkdir(parents=True, exist_ok=True)
        content = {"chunks": [(chunk.start, chunk.stop) for chunk in chunks]}
        save_checkpoint(path, KIND, self.fingerprint, content)
        return list(chunks)

    def of_chunk(self, sequences: slice, streams: RandomStreams, num_steps: int) -> "ChunkKeeper":
        """What keeps one of the chunks; several may work at the same time.

        Args:
            sequences: of the chunk.
            streams: random numbers with which it is tracked.
            num_steps: number K of its steps.
        """
        return ChunkKeeper(self, sequences, streams, num_steps)

    def load(self, path: Path) -> dict[str, Any] | None:
        """Content of a chunk's file, whose time counts from now on; None where there is none."""
        content = load_checkpoint(path, KIND, self.fingerprint)
        if content is not None:
            require_like(path, content.get("seconds"), float, "content.seconds")
            self._earlier = max(self._earlier, content["seconds"])
        return content

    def save(self, path: Path, content: Mapping[str, object]) -> None:
        """Write a chunk's file."""
        self.before()
        save_checkpoint(path, KIND, self.fingerprint, {**content, "seconds": self.seconds})

    def clear(self) -> None:
        """Take the folder away, where the tracks are written and nobody will go on from here."""
        with storing(self.directory):
            shutil.rmtree(self.directory)


class ChunkKeeper:
    """Keeps one chunk of B sequences; call it after each step."""

    def __init__(self, keeper: Keeper, sequences: slice, streams: RandomStreams, num_steps: int) -> None:
        self.keeper, self.streams, self.num_steps = keeper, streams, num_steps
        self.path = keeper.directory / f"{sequences.start}-{sequences.stop - 1}.pt"
        self.estimates: list[StepEstimate] = []
        self.written = time.monotonic()

    def past(self, template: Any, history_of: Callable[[int], TrackHistory]) -> Past[Any] | None:
        """What was kept, the random numbers set to go on from there; None where nothing was.

        Args:
            template: a state of the tracker, nested named tuples of tensors.
            history_of: a history of that many steps, of which shapes and types count.

        Raises:
            InputError: where the file is damaged, or that of another tracker.
        """
        content = self.keeper.load(self.path)
        if content is None:
            return None
        steps = self._steps_in(content)
        streams = self.streams.snapshot()
        expected = {"state": template, "history": tuple(history_of(steps)), "streams": streams}
        require_like(self.path, content, {**expected, "seconds": float})
        device = self.streams.generators[0].device
        history = TrackHistory(*(part.to(device) for part in content["history"]))
        self.streams.skip_to(content["streams"])
        past = Past(revived(template, content["state"]), history)
        self.estimates = past.history.steps(1)
        log.info("sequences %s: %d of %d steps were done, going on", self.path.stem, steps, self.num_steps)
        return past

    def _steps_in(self, content: Mapping[str, Any]) -> int:
        """How many steps were done, as the first field of the history says; the others have to agree."""
        history = content.get("history")
        first = history[0] if isinstance(history, list | tuple) and history else None
        steps = first.shape[1] if isinstance(first, Tensor) and first.ndim > 1 else 0
        if not 1 <= steps <= self.num_steps:
            expected = f"1 to {self.num_steps}; another folder starts anew"
            raise InputError.of_path(self.path, f"a history of {steps} steps", expected)
        return steps

    def __call__(self, step: int, state: Any, estimate: StepEstimate) -> None:
        """Note a step, and write it with all before it where it is time."""
        self.estimates.append(estimate)
        last = step + 1 == self.num_steps
        if not last and time.monotonic() - self.written < self.keeper.every_s:
            return
        history = tuple(part.cpu() for part in TrackHistory.of_steps(self.estimates, 1))
        streams = self.streams.snapshot()
        self.keeper.save(self.path, {"state": plain(state), "history": history, "streams": streams})
        self.written = time.monotonic()


def _chunks_in(path: Path, content: Mapping[str, Any], number: int) -> list[slice]:
    """The chunks of a plan, which are all sequences in order.

    Raises:
        InputError: where they are not.
    """
    require_like(path, content, {"chunks": list})
    chunks = content["chunks"]
    for chunk in chunks:
        require_like(path, chunk, (int, int), "content.chunks")
    ends = [0, *(stop for _, stop in chunks)]
    if [start for start, _ in chunks] != ends[:-1] or ends[-1] != number or sorted(set(ends)) != ends:
        expected = f"consecutive ones of {number} sequences; another folder starts anew"
        raise InputError.of_path(path, f"chunks {chunks}"[:200], expected)
    return [slice(*chunk) for chunk in chunks]


def plain(state: Any) -> Any:
    """Nested named tuples of tensors as nested plain tuples of tensors on the CPU."""
    return state.cpu() if isinstance(state, Tensor) else tuple(map(plain, state))


def revived(template: Any, values: Any) -> Any:
    """Nested plain tuples as the named tuples of a template, nested alike, and on its devices."""
    if isinstance(template, Tensor):
        return values.to(template.device)
    parts = (revived(part, value) for part, value in zip(template, values, strict=True))
    return type(template)(*parts)
