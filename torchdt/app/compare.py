"""How well several trackers do on a suite of scenarios, on the same recordings and in the same field."""

import dataclasses
import logging
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from hydra.core.config_store import ConfigStore
from matplotlib.figure import Figure
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from torchdt.app.build import build_region, build_tracker, build_tracking_field, simulate
from torchdt.app.claims import run_directory
from torchdt.app.figures import ambiguity_surface, axis_of
from torchdt.app.outcomes import Outcome, load_outcomes, save_outcomes
from torchdt.app.parallel import set_threads, track_in_chunks
from torchdt.app.quality import SuiteSettings, compose_track, confidence, one_line, score
from torchdt.app.report.compare_tables import (
    Comparison,
    print_comparison,
    write_comparison,
    write_events,
    write_gospa_table,
)
from torchdt.app.report.comparison import gospa_comparison_figure, trajectory_figure
from torchdt.app.report.console import plain_console
from torchdt.app.report.figures import surface_figure
from torchdt.app.report.files import manifest, write_figures, write_json
from torchdt.app.report.quality import Quality
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings
from torchdt.core.errors import StorageError
from torchdt.core.ranges import Count, Seed, StepIndex
from torchdt.data.prepare import prepare
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField
from torchdt.filter.history import TrackHistory
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.region import Region
from torchdt.simulation.visibility import hidden_steps

log = logging.getLogger(__name__)


@dataclass
class CompareSettings(SuiteSettings):
    """Settings of `experiments/compare.py`.

    Attributes:
        trackers: options of the group `tracker`; all are compared with the first.
        runs: of each scenario, tracked in one batch.
        seed: of the first run; run b has `seed + b`.
        surface_step: step whose estimates are drawn over the ambiguity surface; the last one of shorter
            scenarios.
        tensorboard: write event files.
    """

    trackers: list[str] = dataclasses.field(default_factory=list)
    runs: Count = 10
    seed: Seed = 0
    surface_step: StepIndex = 200
    tensorboard: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_distinct("trackers")


ConfigStore.instance().store(name="compare_schema", node=CompareSettings)


class Stage(NamedTuple):
    """What all trackers of a scenario share.

    Attributes:
        settings: of its first tracker; what is read of them here is the same for all.
        recording: simulated, one sequence for each run.
        field: in which it is tracked, calibrated where that is asked for.
        region: of interest.
        hidden: `(K,)` bool, steps in which not every source can be seen.
        step: index of the step shown over the surface.
        surface: that of the first run at this step, and its grid; None for more than two coordinates.
    """

    settings: TrackSettings
    recording: Recording
    field: BaseField
    region: Region
    hidden: Tensor
    step: int
    surface: tuple[Tensor, list[Tensor]] | None


def run_compare(config: DictConfig) -> list[Comparison]:
    """Track and score every scenario with every tracker, in Hydra's run directory.

    `compare.csv` and `compare.json` grow by a row for each; `<scenario>/` holds `gospa.csv`, `figures/` and
    `tensorboard/<tracker>/`. In the directory of an interrupted run it goes on: rows that are done are not
    computed again, the interrupted one starts anew, and those that failed are tried again.

    Returns:
        One row per scenario and tracker. What fails leaves its error in its row, and the others go on.

    Raises:
        InputError: where the configuration of the suite does not make sense, or the directory holds another
            run, whose results then stay as they are.
        StorageError: where something cannot be written; the same command goes on when it can be.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, CompareSettings)
    directory = run_directory()
    plain = dataclasses.asdict(settings)
    fingerprint = {key: value for key, value in plain.items() if key != "tensorboard"}
    known = load_outcomes(directory / "checkpoint.pt", fingerprint)
    done = {name: rows for name, rows in known.items() if (directory / name / "gospa.csv").is_file()}
    for name in known.keys() - done.keys():
        log.warning("%s was done, but %s is gone: running again", name, directory / name / "gospa.csv")
    if done:
        log.info("going on, %d rows were done", sum(map(len, done.values())))
    write_json(directory / "manifest.json", manifest(plain, settings.seed))
    rows: list[Comparison] = []
    for scenario in settings.suite:
        stage: Stage | None = None
        outcomes = done.setdefault(scenario, {})
        for name in settings.trackers:
            row = Comparison(scenario, tracker=name)
            try:
                if name not in outcomes:
                    track_settings = compose_settings(
                        scenario, name, settings.overrides, settings.seed, settings.runs
                    )
                    stage = stage or set_stage(track_settings, settings)
                    outcome = assess(scenario, stage, track_settings, settings)
                    if settings.tensorboard:
                        events = directory / scenario / "tensorboard" / name
                        write_events(events, name, outcome.quality, outcome.gospa, settings.seed)
                    found = {**outcomes, name: outcome}
                    ordered = {tracker: found[tracker] for tracker in settings.trackers if tracker in found}
                    write_outcomes(directory / scenario, stage, ordered)
                    outcomes[name] = outcome
                    save_outcomes(directory / "checkpoint.pt", fingerprint, done)
                quality, first = outcomes[name].quality, outcomes.get(settings.trackers[0])
                row = beside(name, quality, first and first.quality)
                log.info("%s, %s: GOSPA %.2f in %.1f s", scenario, name, row.gospa, row.seconds)
            except StorageError:
                raise
            except Exception as error:
                log.exception("%s, %s failed", scenario, name)
                row = dataclasses.replace(row, error=one_line(error))
            rows.append(row)
            write_comparison(directory, rows)
    print_comparison(plain_console(), rows)
    log.info("results in %s", directory)
    return rows


def compose_settings(
    scenario: str, tracker: str, overrides: Sequence[str], seed: int, runs: int
) -> TrackSettings:
    """Settings of `experiments/track.py` for one tracker in one scenario."""
    choices = [f"scenario={scenario}", f"tracker={tracker}", *overrides, f"seed={seed}", f"runs={runs}"]
    return compose_track(choices)


def set_stage(track_settings: TrackSettings, settings: CompareSettings) -> Stage:
    """Simulate a scenario and fit the field to it: neither depends on the tracker."""
    set_threads(track_settings)
    recording = simulate(track_settings)
    field = build_tracking_field(track_settings, recording)
    region = build_region(track_settings, track_settings.torch_dtype)
    assert recording.truth is not None
    hidden = hidden_steps(track_settings.scenario, recording.truth[0], settings.separation)
    step, surface = min(settings.surface_step, recording.num_steps - 1), None
    if region.num_coordinates <= 2:
        first = slice(0, 1)
        own = field.select(first)
        measurement = prepare(recording.select(first), own, region).measurement.at(step)
        surface = ambiguity_surface(build_dictionary(own, region), region, measurement)
    return Stage(track_settings, recording, field, region, hidden, step, surface)


def assess(scenario: str, stage: Stage, track_settings: TrackSettings, settings: CompareSettings) -> Outcome:
    """Track and score all runs of one scenario with one tracker."""
    recording = stage.recording
    start = time.perf_counter()
    tracker = build_tracker(track_settings, recording, stage.field)
    ready = time.perf_counter()
    seeds = range(settings.seed, settings.seed + settings.runs)
    tracked = track_in_chunks(track_settings, recording, tracker, seeds)
    history = TrackHistory(*(part.cpu() for part in tracked))
    end = time.perf_counter()
    quality = dataclasses.replace(
        score(scenario, history, recording, track_settings, settings),
        steps_per_second=settings.runs * recording.num_steps / (end - ready),
        real_time=recording.step_s * recording.num_steps / (end - ready),
        seconds=end - start,
    )
    gospa = score_history(history, recording, track_settings)
    assert gospa is not None
    return Outcome(quality, gospa, history.position[0, stage.step][history.declared[0, stage.step]])


def beside(tracker: str, quality: Quality, first: Quality | None) -> Comparison:
    """Scores of a tracker beside those of the first one; None where that one failed."""
    row = Comparison(**vars(quality), tracker=tracker)
    if first is None:
        return row
    pairs = torch.tensor([quality.gospa_by_run, first.gospa_by_run], dtype=torch.float64)
    difference = pairs[0] - pairs[1]
    return dataclasses.replace(
        row,
        ahead=1 - first.gospa / quality.gospa if quality.gospa else math.nan,
        difference=float(difference.mean()),
        difference_ci=confidence(difference),
    )


def write_outcomes(directory: Path, stage: Stage, outcomes: Mapping[str, Outcome]) -> None:
    """Replace the table and the figures of one scenario in its directory, made if absent."""
    write_figures(directory / "figures", draw_comparison(stage, outcomes))
    write_gospa_table(
        directory / "gospa.csv", {name: o.gospa for name, o in outcomes.items()}, stage.recording.times()
    )


def draw_comparison(stage: Stage, outcomes: Mapping[str, Outcome]) -> dict[str, Figure]:
    """Figures of one scenario by name."""
    recording, coordinates = stage.recording, stage.region.coordinates
    assert recording.truth is not None
    truth, axes = recording.truth[0], [axis_of(c) for c in coordinates]
    scores = {name: outcome.gospa for name, outcome in outcomes.items()}
    times = recording.times()[0]
    figures = {"gospa": gospa_comparison_figure(scores, stage.hidden, times, coordinates[0].unit)}
    if stage.surface is not None:
        estimates = {name: outcome.estimates for name, outcome in outcomes.items()}
        figures["estimates"] = surface_figure(*stage.surface, estimates, truth[stage.step], axes)
    if len(coordinates) == 2:
        # Sources that are drawn from the model have no names.
        names = map(str, stage.settings.scenario.sources or range(1, truth.shape[1] + 1))
        tracks = dict(zip(names, truth.unbind(1), strict=True))
        depths = stage.settings.field.get("element_depths")
        array = None if depths is None else torch.tensor(depths, dtype=torch.float64)
        figures["trajectory"] = trajectory_figure(tracks, times, array, axes)
    return figures
