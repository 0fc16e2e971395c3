"""The main job: track a scenario or a recording, and show the result."""

import contextlib
import dataclasses
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from torchdt.experiment.build import build_recording, build_tracker
from torchdt.experiment.figures import draw_figures
from torchdt.experiment.parallel import set_threads, track_in_chunks
from torchdt.experiment.settings import TrackSettings, settings_of
from torchdt.history import TrackHistory
from torchdt.metrics.gospa import Gospa, gospa
from torchdt.protocol import Tracker
from torchdt.report.files import (
    manifest,
    metrics_summary,
    write_gospa_csv,
    write_json,
    write_tracks_csv,
    write_variants_csv,
)
from torchdt.report.tables import print_summary
from torchdt.report.tensorboard import TensorBoardReport
from torchdt.scenario.recording import Recording
from torchdt.tracker import DirectTracker
from torchdt.variants import with_variants

log = logging.getLogger(__name__)


def run_track(config: DictConfig) -> float | None:
    """Run one job in Hydra's run directory.

    Returns:
        Mean GOSPA over runs, those of all variants, and steps, for sweeps to minimise; None without truth.

    Raises:
        InputError: where configuration or data do not make sense.
    """
    settings = settings_of(config)
    directory = Path(HydraConfig.get().runtime.output_dir)
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seed))
    set_threads(settings)
    name = HydraConfig.get().runtime.choices["tracker"]
    recording = build_recording(settings)
    tracker = build_tracker(settings, recording)
    seeds = list(range(settings.seed, settings.seed + recording.batch_size))
    if variants := settings.variant_configs():
        assert isinstance(tracker, DirectTracker)
        tracker = with_variants(tracker, variants, recording.batch_size)
        recording, seeds = recording.repeat(len(variants)), seeds * len(variants)
    alone = HydraConfig.get().mode is not RunMode.MULTIRUN
    visible = settings.logging.progress and alone and sys.stderr.isatty()
    start = time.perf_counter()
    with progress_bar(recording, settings, visible) as on_step:
        history = track_in_chunks(settings, recording, tracker, seeds, on_step)
    seconds = time.perf_counter() - start
    score = score_history(history, recording, settings)
    write_results(directory, name, settings, recording, tracker, history, score, seconds)
    if alone:
        print_summary(Console(), history, score, seconds, title=f"tracker {name}, {settings.scenario.name}")
    log.info("results in %s", directory)
    return None if score is None else float(score.total.mean())


def score_history(history: TrackHistory, recording: Recording, settings: TrackSettings) -> Gospa | None:
    """GOSPA of every run and step, `(B, K)`; None without truth."""
    if recording.truth is None or recording.truth_mask is None:
        return None
    scenario = settings.scenario
    return gospa(
        history.position.double().cpu(),
        history.declared.cpu(),
        recording.truth,
        recording.truth_mask,
        scenario.gospa_cutoff,
        scenario.gospa_order,
    )


@contextlib.contextmanager
def progress_bar(
    recording: Recording, settings: TrackSettings, visible: bool
) -> Iterator[Callable[[int, TrackHistory, slice], None]]:
    """A bar with the steps of all sequences, declared objects and mean GOSPA of all that has come in.

    Hands out the function that moves it, which any thread may call.
    """
    columns = (
        TextColumn("steps"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("declared {task.fields[declared]}"),
        TextColumn("GOSPA {task.fields[score]}"),
        TimeRemainingColumn(),
    )
    lock, scores = threading.Lock(), list[float]()
    with Progress(*columns, console=Console(stderr=True), disable=not visible) as progress:
        total = recording.batch_size * recording.num_steps
        task = progress.add_task("", total=total, declared="-", score="-")

        def on_step(step: int, estimate: TrackHistory, sequences: slice) -> None:
            if not visible:
                return
            declared, number = estimate.declared.sum(-1).double().mean(), len(estimate.declared)
            found = []
            if recording.truth is not None and recording.truth_mask is not None:
                now = gospa(
                    estimate.position.double().cpu(),
                    estimate.declared.cpu(),
                    recording.truth[sequences, step],
                    recording.truth_mask[sequences, step],
                    settings.scenario.gospa_cutoff,
                    settings.scenario.gospa_order,
                )
                found = now.total.tolist()
            with lock:
                scores.extend(found)
                score = f"{sum(scores) / len(scores):.2f}" if scores else "-"
                progress.update(task, advance=number, declared=f"{declared:.3g}", score=score)

        yield on_step


def write_results(
    directory: Path,
    name: str,
    settings: TrackSettings,
    recording: Recording,
    tracker: Tracker[Any],
    history: TrackHistory,
    score: Gospa | None,
    seconds: float,
) -> None:
    """Tables first, then figures and event files of the first run."""
    history = TrackHistory(*(t.cpu() for t in history))
    write_json(directory / "metrics.json", metrics_summary(name, history, score, settings.seed, seconds))
    write_tracks_csv(directory / "tracks.csv", history, recording.step_s, tracker.region.column_names)
    if score is not None:
        write_gospa_csv(directory / "gospa.csv", score)
    if variants := settings.variant_configs():
        write_variants_csv(directory / "variants.csv", variants, history, score)
    figures = {}
    if settings.logging.figures:
        first = slice(0, 1)
        figures = draw_figures(settings, recording.select(first), tracker.select(first), history, score)
        (directory / "figures").mkdir(exist_ok=True)
    for name, figure in figures.items():
        figure.savefig(directory / "figures" / f"{name}.png", dpi=150)
    if settings.logging.tensorboard:
        with TensorBoardReport(directory / "tensorboard") as report:
            report.add_history(history.select(0), None if score is None else score.select(0))
            for name, figure in figures.items():
                report.add_figure(f"figures/{name}", figure)
            report.add_config(dataclasses.asdict(settings))
