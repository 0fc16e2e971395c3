"""The sky over a radio array: tables and a figure."""

import os
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from rich.console import Console
from rich.table import Table
from torch import Tensor

from recordings.tart_score import CLOSE, SkyScore
from torchdt.app.report.csv_file import write_csv
from torchdt.app.report.figures import COLOURS, MARKERS, to_array
from torchdt.filter.history import TrackHistory


def print_sky(console: Console, scores: Mapping[str, SkyScore], title: str) -> None:
    """Print one row for each method."""
    table = Table(
        title=title, caption=f"degrees; near: within {CLOSE:g} of a satellite", caption_justify="left"
    )
    for name in ("method", "declared", "near (%)", "median", "GOSPA", "missed", "false", "switches"):
        table.add_column(name, justify="left" if name == "method" else "right")
    for method, s in scores.items():
        numbers = (s.declared, 100 * s.close, s.median_error, s.gospa, s.missed, s.false)
        cells = [f"{number:.{digits}f}" for number, digits in zip(numbers, (1, 1, 2, 1, 1, 1), strict=True)]
        table.add_row(method, *cells, "-" if s.switches is None else str(s.switches))
    console.print(table)


def write_sky_csv(path: str | os.PathLike[str], scores: Mapping[str, SkyScore]) -> None:
    """Write one row for each method; an empty cell is a score that it does not have."""
    write_csv(path, ("method", *SkyScore._fields), ((method, *score) for method, score in scores.items()))


def sky_figure(history: TrackHistory, truth: Tensor) -> Figure:
    """Declared tracks over the ways of the satellites: north is up, the horizon is the rim.

    Args:
        history: of one run, positions `(K, N, 2)` in direction cosines to the east and north.
        truth: `(K, L, 2)`, NaN = absent.
    """
    figure = Figure(figsize=(7.2, 5.6), layout="constrained")
    panel = figure.add_subplot(projection="polar")
    assert isinstance(panel, PolarAxes)
    panel.set_theta_zero_location("N")
    panel.set_theta_direction(-1)
    panel.set_ylim(0, 90)
    panel.set_rgrids((15, 30, 45, 60, 75), ["75°", "60°", "45°", "30°", "15°"])
    azimuth, zenith = _polar(to_array(truth))
    for index in range(azimuth.shape[1]):
        name = "satellites" if index == 0 else None
        panel.plot(azimuth[:, index], zenith[:, index], color="black", lw=6, alpha=0.25, label=name)
        panel.plot(azimuth[-1, index], zenith[-1, index], "o", color="black", ms=7, alpha=0.25)
    azimuth, zenith = _polar(to_array(history.position))
    declared, label = to_array(history.declared), to_array(history.label)
    for order, value in enumerate(np.unique(label[declared]).tolist()):
        chosen = declared & (label == value)
        panel.plot(
            azimuth[chosen],
            zenith[chosen],
            ls="none",
            marker=MARKERS[order // len(COLOURS) % len(MARKERS)],
            ms=3,
            mew=0,
            color=COLOURS[order % len(COLOURS)],
            label=f"track {value}",
        )
    figure.legend(loc="outside right upper", frameon=False, markerscale=2)
    return figure


def _polar(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth in radians clockwise from north, and degrees from the zenith."""
    east, north = position[..., 0], position[..., 1]
    return np.arctan2(east, north), np.degrees(np.arcsin(np.hypot(east, north).clip(max=1)))
