"""Progress bars of the jobs."""

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

from torchdt.app.score import score_step
from torchdt.app.settings import TrackSettings
from torchdt.app.tune_settings import TuneSettings
from torchdt.data.recording import Recording
from torchdt.filter.history import StepEstimate
from torchdt.tuning.state import TuningState

Observer = Callable[[int, Any, StepEstimate, slice], None]
"""What `torchdt.run.track.track` calls after each step."""


def is_alone() -> bool:
    """Whether this job is no part of a multirun."""
    return HydraConfig.get().mode is not RunMode.MULTIRUN


@contextlib.contextmanager
def track_progress(recording: Recording, settings: TrackSettings) -> Iterator[Observer]:
    """A bar with the steps of all sequences, declared objects and mean GOSPA of all that has come in.

    Hands out the function that moves it, which any thread may call.
    """
    fields = ("declared {task.fields[declared]}", "GOSPA {task.fields[score]}")
    lock, done, scores = threading.Lock(), dict[int, int](), list[float]()
    with _bar(settings, "steps", fields) as progress:
        total = recording.batch_size * recording.num_steps
        task = progress.add_task("", total=total, declared="-", score="-")

        def on_step(step: int, state: object, estimate: StepEstimate, sequences: slice) -> None:
            if progress.disable:
                return
            declared, number = estimate.declared.sum(-1).double().mean(), len(estimate.declared)
            score = score_step(step, estimate, sequences, recording, settings)
            with lock:
                done[sequences.start] = number * (step + 1)
                scores.extend([] if score is None else score.total.tolist())
                mean = f"{sum(scores) / len(scores):.2f}" if scores else "-"
                progress.update(task, completed=sum(done.values()), declared=f"{declared:.3g}", score=mean)

        yield on_step


@contextlib.contextmanager
def tune_progress(settings: TuneSettings) -> Iterator[Callable[[TuningState], None]]:
    """A bar with steps (passes of a search) and how they go; hands out the function that moves it."""
    climbing = settings.tuning.method == "gradient"
    fields = (
        "objective {task.fields[objective]}",
        "best held-out {task.fields[heldout]}",
        "skipped {task.fields[skipped]}",
    )
    total = settings.tuning.steps + 1 if climbing else settings.tuning.budget_passes
    with _bar(settings, "step" if climbing else "pass", fields) as progress:
        task = progress.add_task("", total=total, objective="-", heldout="-", skipped=0)

        def advance(state: TuningState) -> None:
            objective = state.records[-1].objective
            progress.update(
                task,
                completed=len(state.records) if climbing else state.passes,
                objective="-" if objective is None else f"{objective:.4f}",
                heldout="-" if state.best_heldout is None else f"{state.best_heldout:.4f}",
                skipped=state.skipped,
            )

        yield advance


def _bar(settings: TrackSettings, unit: str, fields: tuple[str, ...]) -> Progress:
    """A bar on a terminal; one that shows nothing where there is none, and under multirun."""
    visible = settings.logging.progress and is_alone() and sys.stderr.isatty()
    middle: list[ProgressColumn] = [BarColumn(), MofNCompleteColumn(), *map(TextColumn, fields)]
    columns = (TextColumn(unit), *middle, TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=not visible)
