"""One scenario of a suite: what all trackers share, and what one of them makes of it."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchdt.app.build import build_region, build_tracker, build_tracking_field, simulate_each
from torchdt.app.figures import ambiguity_surface, axis_of
from torchdt.app.outcomes import Outcome
from torchdt.app.parallel import set_threads, track_in_chunks
from torchdt.app.report.compare_tables import write_gospa_table
from torchdt.app.report.comparison import gospa_comparison_figure, trajectory_figure
from torchdt.app.report.figures import surface_figure
from torchdt.app.report.files import write_figures
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings
from torchdt.app.suite import SuiteSettings, score
from torchdt.core.trees import tree_map
from torchdt.data.prepare import prepare
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.region import Region
from torchdt.simulation.visibility import hidden_steps


class Stage(NamedTuple):
    """What all trackers of a scenario share.

    Attributes:
        settings: of its first tracker; what is read of them here is the same for all.
        seeds: of the runs.
        recording: simulated, one sequence for each run.
        field: in which it is tracked, calibrated where that is asked for.
        fitting_s: seconds that the field took, where one tracker has it for itself; else zero.
        region: of interest.
        hidden: `(K,)` bool, steps in which not every source can be seen.
        step: index of the step shown over the surface.
        surface: that of the first run at this step, and its grid; None for more than two coordinates.
    """

    settings: TrackSettings
    seeds: Sequence[int]
    recording: Recording
    field: BaseField
    fitting_s: float
    region: Region
    hidden: Tensor
    step: int
    surface: tuple[Tensor, list[Tensor]] | None


def set_stage(
    track_settings: TrackSettings, settings: SuiteSettings, seeds: Sequence[int], shared: bool
) -> Stage:
    """Simulate a scenario and fit the field to it: neither depends on the tracker."""
    set_threads(track_settings)
    recording = simulate_each(track_settings, seeds)
    start = time.perf_counter()
    field = build_tracking_field(track_settings, recording)
    fitting_s = 0.0 if shared else time.perf_counter() - start
    region = build_region(track_settings, track_settings.torch_dtype)
    assert recording.truth is not None
    hidden = hidden_steps(track_settings.scenario, recording.truth[0], settings.separation)
    step, surface = min(settings.surface_step, recording.num_steps - 1), None
    if region.num_coordinates <= 2:
        first = slice(0, 1)
        own = field.select(first)
        measurement = prepare(recording.select(first), own, region).measurement.at(step)
        surface = ambiguity_surface(build_dictionary(own, region), region, measurement)
    return Stage(track_settings, seeds, recording, field, fitting_s, region, hidden, step, surface)


def assess(scenario: str, stage: Stage, track_settings: TrackSettings, settings: SuiteSettings) -> Outcome:
    """Track and score all runs of one scenario with one tracker."""
    recording = stage.recording
    start = time.perf_counter()
    tracker = build_tracker(track_settings, recording, stage.field)
    ready = time.perf_counter()
    tracked = track_in_chunks(track_settings, recording, tracker, stage.seeds)
    history = tree_map(lambda part: part.cpu(), tracked)
    end = time.perf_counter()
    quality = dataclasses.replace(
        score(scenario, history, recording, track_settings, settings),
        steps_per_second=recording.batch_size * recording.num_steps / (end - ready),
        real_time=recording.step_s * recording.num_steps / (end - ready),
        seconds=stage.fitting_s + end - start,
    )
    gospa = score_history(history, recording, track_settings)
    assert gospa is not None
    return Outcome(quality, gospa, history.position[0, stage.step][history.declared[0, stage.step]])


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
    unit = stage.settings.scenario.distance_unit
    figures = {"gospa": gospa_comparison_figure(scores, stage.hidden, times, unit)}
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
