"""The job that tracks the sky over a radio array, beside single steps and conventional tracking."""

import dataclasses
import logging
import time
from pathlib import Path

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig

from recordings.tart_file import LOWEST
from recordings.tart_recording import TartSettings
from recordings.tart_report import print_sky, sky_figure, write_sky_csv
from recordings.tart_score import SkyScore, sky_gospa, sky_score
from torchdt.app.build import build_recording, build_tracker, build_tracking_field
from torchdt.app.claims import run_directory
from torchdt.app.parallel import set_threads, track_in_chunks
from torchdt.app.progress import track_progress
from torchdt.app.report.console import plain_console
from torchdt.app.report.files import (
    manifest,
    metrics_summary,
    write_figures,
    write_gospa_csv,
    write_json,
    write_tracks_csv,
)
from torchdt.app.settings import TrackSettings, settings_of
from torchdt.app.targets import build_config
from torchdt.baselines.detect.points import Points
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import require
from torchdt.core.trees import tree_map
from torchdt.data.recording import Recording
from torchdt.filter.history import TrackHistory

log = logging.getLogger(__name__)


@dataclasses.dataclass
class SkySettings(TrackSettings):
    """Settings of `experiments/tart.py`.

    Attributes:
        conventional: tracker of points to compare with; its detector is also scored alone.
    """

    conventional: TwoStepConfig = dataclasses.field(default_factory=TwoStepConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        build_config(self.conventional)


ConfigStore.instance().store(name="sky_schema", node=SkySettings)


def run_tart(config: DictConfig) -> dict[str, SkyScore]:
    """Track one recording directly, by its peaks, and conventionally, in Hydra's run directory.

    Returns:
        Scores of satellites and estimates above `LOWEST` degrees, by method.

    Raises:
        InputError: where configuration or data do not make sense.
    """
    settings = settings_of(config)
    assert isinstance(settings, SkySettings)
    require(isinstance(settings.data, TartSettings), "data", settings.data.kind, "tart")
    directory = run_directory()
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seed))
    set_threads(settings)
    recording = build_recording(settings)
    field = build_tracking_field(settings, recording)
    tracker = build_tracker(settings, recording, field)
    start = time.perf_counter()
    with track_progress(recording, settings) as on_step:
        history = track_in_chunks(settings, recording, tracker, [settings.seed], on_step)
    seconds = time.perf_counter() - start
    other = dataclasses.replace(settings, tracker=settings.conventional)
    conventional = build_tracker(other, recording, field)
    assert isinstance(conventional, TwoStepTracker)
    points = conventional.detector(conventional.prepare(recording).measurement)
    tracked = track_in_chunks(other, recording, conventional, [settings.seed])
    scores = {
        "direct": score_history(history, recording),
        "peaks": _score_points(points, recording),
        "mp_bp": score_history(tracked, recording),
    }
    write_results(directory, settings, history, recording, seconds, tracker.region.column_names)
    write_json(directory / "tart.json", {method: score._asdict() for method, score in scores.items()})
    write_sky_csv(directory / "tart.csv", scores)
    count = f"{recording.num_steps} steps, each of {recording.num_snapshots:.0f} effective snapshots"
    print_sky(plain_console(), scores, f"{recording.name}: {count}")
    log.info("results in %s", directory)
    return scores


def score_history(history: TrackHistory, recording: Recording) -> SkyScore:
    """Score the first sequence; objects below `LOWEST` degrees are left out, as satellites are."""
    assert recording.truth is not None
    one = history.select(0)
    position = one.position.double().cpu()
    declared = one.declared.cpu() & _is_up(position)
    return sky_score(
        position, declared, one.label.cpu(), one.power[..., 0].double().cpu(), recording.truth[0]
    )


def write_results(
    directory: Path,
    settings: TrackSettings,
    history: TrackHistory,
    recording: Recording,
    seconds: float,
    columns: tuple[str, ...],
) -> None:
    """Tables and the picture of direct tracking; GOSPA in degrees."""
    assert recording.truth is not None
    history = tree_map(lambda t: t.cpu(), history)
    position = history.position.double()
    gospa = sky_gospa(position, history.declared & _is_up(position), recording.truth)
    write_json(directory / "metrics.json", metrics_summary("direct", history, gospa, settings.seed, seconds))
    write_gospa_csv(directory / "gospa.csv", gospa, recording.times())
    write_tracks_csv(directory / "tracks.csv", history, recording.times(), columns)
    if settings.logging.figures:
        write_figures(directory / "figures", {"sky": sky_figure(history.select(0), recording.truth[0])})


def _score_points(points: Points, recording: Recording) -> SkyScore:
    assert recording.truth is not None
    position = points.position[0].double().cpu()
    present = points.present[0].cpu() & _is_up(position)
    return sky_score(position, present, None, points.power[0, ..., 0].double().cpu(), recording.truth[0])


def _is_up(position: torch.Tensor) -> torch.Tensor:
    limit = torch.deg2rad(torch.tensor(LOWEST, dtype=torch.float64)).cos()
    return torch.linalg.vector_norm(position, dim=-1) < limit
