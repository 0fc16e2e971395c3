"""Figures of one tracked sequence."""

from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchdt.app.report.figures import Axis, gospa_figure, surface_figure, tracks_figure
from torchdt.app.settings import TrackSettings
from torchdt.data.recording import Recording
from torchdt.filter.history import TrackHistory
from torchdt.filter.proposal.dictionary import Dictionary, bartlett_surface
from torchdt.filter.tracker import Tracker
from torchdt.metrics.gospa import Gospa
from torchdt.model.measurement import Measurement
from torchdt.model.region import Coordinate, Region


def axis_of(coordinate: Coordinate) -> Axis:
    """How a coordinate is drawn: kilometres from 2000 m up, depths downward."""
    kilometres = coordinate.unit == "m" and coordinate.high - coordinate.low >= 2000
    unit, scale = ("km", 1e-3) if kilometres else (coordinate.unit, 1.0)
    label, middle = f"{coordinate.name.capitalize()} ({unit})", (coordinate.low + coordinate.high) / 2
    return Axis(label, scale, coordinate.name == "depth", middle, coordinate.period)


def draw_figures(
    settings: TrackSettings,
    recording: Recording,
    tracker: Tracker[Any],
    history: TrackHistory,
    score: Gospa | None,
) -> dict[str, Figure]:
    """Figures of the first sequence by name.

    Args:
        history: batch shape `(B,)`, on the CPU.
        score: `(B, K)`, None without truth.
    """
    coordinates = tracker.region.coordinates
    axes = [axis_of(c) for c in coordinates]
    first, times = history.select(0), recording.times()[0]
    truth = None if recording.truth is None else recording.truth[0]
    figures = {"tracks": tracks_figure(first, truth, times, axes)}
    if score is not None:
        figures["gospa"] = gospa_figure(score.select(0), times, settings.scenario.distance_unit)
    if len(coordinates) <= 2:
        step = min(settings.logging.surface_step, recording.num_steps - 1)
        measurement = tracker.prepare(recording).measurement.at(step)
        decibels, grid = ambiguity_surface(tracker.dictionary, tracker.region, measurement)
        estimates = {"estimate": first.position[step][first.declared[step]]}
        figures["surface"] = surface_figure(
            decibels, grid, estimates, None if truth is None else truth[step], axes
        )
    return figures


def ambiguity_surface(
    dictionary: Dictionary, region: Region, measurement: Measurement
) -> tuple[Tensor, list[Tensor]]:
    """Power of the conventional beamformer for the first sequence, on the CPU.

    Args:
        dictionary: responses at the centres of the region's birth cells.
        region: of one or two coordinates.
        measurement: of one step, batch `(B,)`.

    Returns:
        `(A,)` or `(A, B)` in dB, and for each dimension the values of its coordinate.
    """
    surface = bartlett_surface(dictionary, measurement)[0].reshape(region.grid_shape)
    decibels = 10 * surface.clamp_min(torch.finfo(surface.dtype).tiny).log10().cpu()
    centres = dictionary.points.reshape(*region.grid_shape, -1).cpu()
    grid = [
        centres.movedim(d, 0).reshape(n, -1, region.num_coordinates)[:, 0, d]
        for d, n in enumerate(region.grid_shape)
    ]
    return decibels, grid
