"""The main job: track a scenario or a recording, and show the result."""

import dataclasses
import logging
import time
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from torchdt.app.build import build_recording, build_tracker
from torchdt.app.claims import run_directory
from torchdt.app.figures import draw_figures
from torchdt.app.live import LiveReport
from torchdt.app.parallel import set_threads, track_in_chunks
from torchdt.app.progress import is_alone, track_progress
from torchdt.app.report.console import plain_console
from torchdt.app.report.energy import hints
from torchdt.app.report.files import (
    manifest,
    metrics_summary,
    write_energy_csv,
    write_figures,
    write_gospa_csv,
    write_json,
    write_tracks_csv,
    write_variants_csv,
)
from torchdt.app.report.tables import print_summary
from torchdt.app.resume import RunCheckpoint, fingerprint_of
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings, settings_of
from torchdt.core.trees import tree_map
from torchdt.data.recording import Recording
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.tracker import Tracker
from torchdt.metrics.gospa import Gospa
from torchdt.run.variants import with_variants

log = logging.getLogger(__name__)


def run_track(config: DictConfig) -> float | None:
    """Run one job in Hydra's run directory.

    In that of an interrupted run it goes on and ends with the same numbers; in that of a finished one nothing
    is computed or written, unless a table is gone: then it is run again.

    Returns:
        Mean GOSPA over runs, those of all variants, and steps, for sweeps to minimise; None without truth.

    Raises:
        InputError: where configuration or data do not make sense, or the directory holds another run, whose
            results then stay as they are.
        StorageError: where something cannot be written; the same command goes on when it can be.
    """
    settings = settings_of(config)
    directory = run_directory()
    name = HydraConfig.get().runtime.choices["tracker"]
    fingerprint = {"tracker": name, **fingerprint_of(settings)}
    checkpoint = RunCheckpoint(directory, fingerprint, settings.checkpoint_s)
    if checkpoint.finished:
        tables = ["metrics.json", "tracks.csv"] + ["gospa.csv"] * (checkpoint.score is not None)
        tables += ["variants.csv"] * bool(settings.variants)
        gone = [table for table in tables if not (directory / table).is_file()]
        if not gone:
            log.info("finished before, nothing to do: %s", directory)
            return checkpoint.score
        log.warning("finished before, but without %s now: running again", ", ".join(gone))
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seed))
    set_threads(settings)
    recording, tracker, seeds = set_up(settings)
    with LiveReport(directory / "tensorboard", recording, tracker.region, settings) as live:
        keep = checkpoint.keeper(before=live.flush)
        start = time.perf_counter()
        with track_progress(recording, settings) as advance:

            def on_step(*step: Any) -> None:
                advance(*step)
                live(*step)

            history = track_in_chunks(settings, recording, tracker, seeds, on_step, keep)
        seconds = time.perf_counter() - start if keep is None else keep.seconds
        score = score_history(history, recording, settings)
        write_results(directory, name, settings, recording, tracker, history, score, seconds, live)
    value = None if score is None else float(score.total.mean())
    if keep is not None:
        checkpoint.finish(value, keep)
    if is_alone():
        print_summary(
            plain_console(), history, score, seconds, title=f"tracker {name}, {settings.scenario.name}"
        )
    if failed := int(history.failed.sum()):
        log.warning("%d of %d steps broke down and count as missing", failed, history.failed.numel())
    for hint in hints(history):
        log.warning(hint)
    quality = "no truth to score" if value is None else f"mean GOSPA {value:.3g}"
    log.info(
        "%d steps in %.1f s, %s, results in %s",
        history.existence[..., 0].numel(),
        seconds,
        quality,
        directory,
    )
    return value


def set_up(settings: TrackSettings) -> tuple[Recording, Tracker[Any], list[int]]:
    """Recording, tracker and a seed for each sequence, those of all variants."""
    recording = build_recording(settings)
    tracker = build_tracker(settings, recording)
    seeds = list(range(settings.seed, settings.seed + recording.batch_size))
    if variants := settings.variant_models():
        assert isinstance(tracker, DirectTracker)
        tracker = with_variants(tracker, variants, recording.batch_size)
        recording, seeds = recording.repeat(len(variants)), seeds * len(variants)
    return recording, tracker, seeds


def write_results(
    directory: Path,
    name: str,
    settings: TrackSettings,
    recording: Recording,
    tracker: Tracker[Any],
    history: TrackHistory,
    score: Gospa | None,
    seconds: float,
    live: LiveReport,
) -> None:
    """Tables first, then figures, and what the event files of the first run lack."""
    history = tree_map(lambda t: t.cpu(), history)
    metrics = metrics_summary(name, history, score, settings.seed, seconds)
    write_json(directory / "metrics.json", metrics)
    write_energy_csv(directory / "energy.csv", history, recording.times())
    write_tracks_csv(directory / "tracks.csv", history, recording.times(), tracker.region.column_names)
    if score is not None:
        write_gospa_csv(directory / "gospa.csv", score, recording.times())
    if variants := settings.variant_models():
        write_variants_csv(directory / "variants.csv", variants, history, score)
    figures = {}
    if settings.logging.figures:
        first = slice(0, 1)
        figures = draw_figures(settings, recording.select(first), tracker.select(first), history, score)
        write_figures(directory / "figures", figures)
    if settings.logging.tensorboard:
        live.finish(figures, history, metrics)
