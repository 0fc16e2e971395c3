"""Figures of a run. They are plain `Figure` objects: save them with `figure.savefig`."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from torch import Tensor

from torchdt.filter.history import TrackHistory
from torchdt.metrics import Gospa

# Okabe and Ito, "Color universal design" (2008): told apart under all common colour blindness. Black is
# kept for the truth, yellow left out as it is hard to see on white.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# Open ones, of sets of points: what lies on top of something else does not cover it.
POINT_MARKERS = ("x", "s", "^", "D", "v", "+")
MAX_LEGEND_LABELS = 12


class Axis(NamedTuple):
    """How a position coordinate is drawn.

    Attributes:
        label: text at the axis, unit included.
        scale: factor from the coordinate to what is drawn.
        downward: values grow downward, as depths do.
        middle, period: of a coordinate that goes round, in its unit: what is drawn is within half a period of
            the middle. None: it does not go round.
    """

    label: str
    scale: float = 1.0
    downward: bool = False
    middle: float = 0.0
    period: float | None = None

    def place(self, values: np.ndarray) -> np.ndarray:
        """Where values of the coordinate are drawn."""
        if self.period is not None:
            values = values - self.period * np.round((values - self.middle) / self.period)
        return values * self.scale


WAVEGUIDE_AXES = (Axis("Range (km)", 1e-3), Axis("Depth (m)", downward=True))


def tracks_figure(
    history: TrackHistory, truth: Tensor | None, times: Tensor, axes: Sequence[Axis] = WAVEGUIDE_AXES
) -> Figure:
    """Draw declared estimates and true positions over time, one panel per coordinate.

    Args:
        history: of one run, fields `(K, ...)`.
        truth: `(K, L, d)` true positions, NaN = absent; None if unknown.
        times: `(K,)` seconds.
        axes: of the d coordinates.
    """
    figure = Figure(figsize=(7.2, 1.0 + 2.2 * len(axes)), layout="constrained")
    panels: list[Axes] = list(figure.subplots(len(axes), 1, sharex=True, squeeze=False)[:, 0])
    minutes = to_array(times) / 60
    declared, label, position = (
        to_array(history.declared),
        to_array(history.label),
        to_array(history.position),
    )
    labels, counts = np.unique(label[declared], return_counts=True)
    in_legend = labels[np.argsort(-counts, kind="stable")][:MAX_LEGEND_LABELS]

    for coordinate, (panel, axis) in enumerate(zip(panels, axes, strict=True)):
        if truth is not None:
            for index, values in enumerate(to_array(truth[..., coordinate]).T):
                name = "truth" if index == 0 else None
                line = cut_line([minutes, axis.place(values)], [None, axis])
                panel.plot(*line, color="black", lw=4, alpha=0.25, label=name)
        for order, value in enumerate(labels.tolist()):
            step, slot = np.nonzero(declared & (label == value))
            panel.plot(
                minutes[step],
                axis.place(position[step, slot, coordinate]),
                ls="none",
                marker=MARKERS[order // len(COLOURS) % len(MARKERS)],
                ms=3,
                mew=0,
                color=COLOURS[order % len(COLOURS)],
                label=f"track {value}" if value in in_legend else None,
            )
        panel.set_ylabel(axis.label)
        panel.grid(alpha=0.3)
        if axis.downward:
            panel.invert_yaxis()
    panels[-1].set_xlabel("Time (min)")
    legend_outside(panels[0], len(labels) - len(in_legend))
    return figure


def gospa_figure(gospa: Gospa, times: Tensor, unit: str = "m") -> Figure:
    """Draw GOSPA over time on top of its stacked parts, which add up to it for order p = 1.

    Args:
        gospa: of one run, fields `(K,)`.
        times: `(K,)` seconds.
        unit: of the distance, empty for none.
    """
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    panel = figure.subplots()
    minutes = to_array(times) / 60
    parts = [to_array(part) for part in (gospa.localisation, gospa.missed, gospa.false)]
    panel.stackplot(
        minutes, parts, labels=("localisation", "missed", "false"), colors=COLOURS[:3], alpha=0.7, step="mid"
    )
    mean = gospa.total.mean().item()
    panel.step(
        minutes, to_array(gospa.total), where="mid", color="black", lw=0.8, label=f"GOSPA, mean {mean:.1f}"
    )
    finish_gospa(panel, unit)
    return figure


def surface_figure(
    surface: Tensor,
    grid: Sequence[Tensor],
    estimates: Mapping[str, Tensor],
    truth: Tensor | None = None,
    axes: Sequence[Axis] = WAVEGUIDE_AXES,
    dynamic_range: float = 20.0,
) -> Figure:
    """Draw an ambiguity surface with the estimates and true positions of one step on it.

    Args:
        surface: `(A,)` or `(A, B)` in dB, over one or two coordinates.
        grid: for each dimension of the surface the values `(A,)`, `(B,)` of its coordinate, increasing.
        estimates: `(N, d)` declared positions by the name under which they are drawn.
        truth: `(L, d)` true positions, NaN = absent; None if unknown.
        axes: of the d = 1 or 2 coordinates.
        dynamic_range: dB below the maximum that are shown.

    Raises:
        ValueError: numbers of dimensions that do not fit each other.
    """
    widths = {position.shape[-1] for position in estimates.values()}
    if surface.dim() not in (1, 2) or {surface.dim(), len(grid), len(axes)} | widths != {surface.dim()}:
        positions = ", ".join(f"positions {width}" for width in sorted(widths))
        found = f"surface {surface.dim()}, grid {len(grid)}, axes {len(axes)}, {positions}"
        raise ValueError(f"dimensions: found {found}, expected one or two, the same for all")
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    panel = figure.subplots()
    values = to_array(surface)
    top = float(np.nanmax(values))
    ticks = [to_array(vector) * axis.scale for vector, axis in zip(grid, axes, strict=True)]
    points = [
        (name, position, POINT_MARKERS[index % len(POINT_MARKERS)], method_colour(index), 8)
        for index, (name, position) in enumerate(estimates.items())
    ]
    if truth is not None:
        points.insert(0, ("truth", truth[~truth.isnan().any(-1)], "o", "black", 11))

    if surface.dim() == 2:
        mesh = panel.pcolormesh(
            *ticks, values.T, cmap="cividis", vmin=top - dynamic_range, vmax=top, rasterized=True
        )
        figure.colorbar(mesh, ax=panel, label="Power (dB)", extend="min", pad=0.02)
        panel.set_ylabel(axes[1].label)
        if axes[1].downward:
            panel.invert_yaxis()
    else:
        panel.plot(ticks[0], values, color=COLOURS[0], lw=1.2)
        panel.set_ylabel("Power (dB)")
        panel.set_ylim(top - dynamic_range, top + 0.1 * dynamic_range)
        panel.grid(alpha=0.3)
    panel.set_xlabel(axes[0].label)

    for name, position, marker, colour, size in points:
        x = axes[0].place(to_array(position[:, 0]))
        y = axes[1].place(to_array(position[:, 1])) if surface.dim() == 2 else np.interp(x, ticks[0], values)
        (line,) = panel.plot(x, y, marker, ms=size, mew=2, mfc="none", color=colour, label=name)
        if surface.dim() == 2:
            line.set_path_effects([withStroke(linewidth=4, foreground="white")])
    figure.legend(loc="outside upper right", ncols=len(points), frameon=False)
    return figure


def cut_line(line: Sequence[np.ndarray], axes: Sequence[Axis | None]) -> list[np.ndarray]:
    """A line with NaN between both sides of the seam of a coordinate, so that it does not cross the figure.

    Args:
        line: for each coordinate, or time, what is drawn of K points `(K,)`.
        axes: of these; None for time.
    """
    across = np.zeros(len(line[0]) - 1, dtype=bool)
    for values, axis in zip(line, axes, strict=True):
        if axis is not None and axis.period is not None:
            across |= np.abs(np.diff(values)) > axis.period * axis.scale / 2
    return [np.insert(values, np.flatnonzero(across) + 1, np.nan) for values in line]


def method_colour(index: int) -> str:
    """Colour of a method's estimates, the same in all figures; the first stands out from a dark surface."""
    return COLOURS[(index + 1) % len(COLOURS)]


def to_array(values: Tensor) -> np.ndarray:
    """What matplotlib takes, on the CPU and without gradient."""
    return values.detach().cpu().numpy()


def finish_gospa(panel: Axes, unit: str) -> None:
    """Label a panel of GOSPA over minutes, and put its legend beside it."""
    panel.set_xlabel("Time (min)")
    panel.set_ylabel(f"GOSPA ({unit})" if unit else "GOSPA")
    panel.set_ylim(bottom=0)
    panel.margins(x=0)
    panel.grid(alpha=0.3)
    legend_outside(panel)


def legend_outside(panel: Axes, num_hidden: int = 0) -> None:
    """Put the legend to the right of the panel, where it hides nothing."""
    title = f"{num_hidden} more not listed" if num_hidden else None
    if panel.get_legend_handles_labels()[0]:
        panel.legend(
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            frameon=False,
            markerscale=2,
            title=title,
            alignment="left",
        )
