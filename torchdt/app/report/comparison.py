"""Figures that set several trackers side by side, after those of Liang and Meyer, Sec. IV.

Their third figure, estimates over the ambiguity surface, is `torchdt.app.report.figures.surface_figure`.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from torch import Tensor

from torchdt.app.report.figures import (
    COLOURS,
    WAVEGUIDE_AXES,
    Axis,
    cut_line,
    finish_gospa,
    legend_outside,
    method_colour,
    to_array,
)
from torchdt.metrics import Gospa

TICK_MINUTES = 5


def trajectory_figure(
    truth: Mapping[str, Tensor],
    times: Tensor,
    element_depths: Tensor | None = None,
    axes: Sequence[Axis] = WAVEGUIDE_AXES,
) -> Figure:
    """Draw where sources go in the plane of range and depth, and the array.

    A circle is where a source starts, a dot where it is at every fifth minute, with that number of minutes
    beside it.

    Args:
        truth: `(K, 2)` true positions by the source's name, NaN = absent.
        times: `(K,)` of the steps, s.
        element_depths: `(M,)` m, of a vertical array at range zero; None draws no array.
        axes: of range and depth.
    """
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    panel = figure.subplots()
    for index, (name, track) in enumerate(truth.items()):
        colour, up = COLOURS[index % len(COLOURS)], index % 2 == 0
        line = [axis.place(values) for axis, values in zip(axes, to_array(track).T, strict=True)]
        points = np.stack(line, -1)
        panel.plot(*cut_line(line, axes), color=colour, lw=1.5, label=name)
        present = ~np.isnan(points).any(-1)
        start = points[present.argmax()]
        panel.plot(*start, "o", ms=9, mew=1.5, mfc="none", color=colour)
        for minute, step in tick_steps(times).items():
            # A source that stays would have all its numbers in one place, where none could be read.
            if not present[step] or (points[step] == start).all():
                continue
            panel.plot(*points[step], ".", ms=7, color=colour)
            panel.annotate(
                str(minute),
                points[step],
                xytext=(0, 5 if up else -5),
                textcoords="offset points",
                ha="center",
                va="bottom" if up else "top",
                color=colour,
                fontsize="small",
            )
    if element_depths is not None:
        depths = to_array(element_depths) * axes[1].scale
        panel.plot(np.zeros_like(depths), depths, "k_", ms=7, mew=1.5, label="array")
    panel.set_xlabel(axes[0].label)
    panel.set_ylabel(axes[1].label)
    panel.margins(y=0.2)
    if axes[1].downward:
        panel.invert_yaxis()
    panel.grid(alpha=0.3)
    legend_outside(panel)
    return figure


def tick_steps(times: Tensor) -> dict[int, int]:
    """Steps nearest to every fifth minute after the first of the times `(K,)` s, by that minute."""
    first, last = (math.floor(times[end].item() / 60 / TICK_MINUTES) for end in (0, -1))
    minutes = [TICK_MINUTES * number for number in range(first + 1, last + 1)]
    return {minute: int((times - 60 * minute).abs().argmin()) for minute in minutes}


def gospa_comparison_figure(
    scores: Mapping[str, Gospa], hidden: Tensor, times: Tensor, unit: str = "m"
) -> Figure:
    """Draw the mean GOSPA of several trackers over time; the means in the legend leave hidden steps out.

    Args:
        scores: `(B, K)` by the tracker's name.
        hidden: `(K,)` bool, steps in which not every source can be seen, shaded.
        times: `(K,)` of the steps, s.
        unit: of the distance, empty for none.
    """
    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    panel = figure.subplots()
    minutes = to_array(times) / 60
    # Half-way between the steps.
    bounds = np.concatenate([minutes[:1], (minutes[1:] + minutes[:-1]) / 2, minutes[-1:]])
    # Where the flag changes: first hidden step and first visible one, in turn.
    edges = np.flatnonzero(np.diff(np.pad(to_array(hidden).astype(int), 1))).reshape(-1, 2)
    for order, (left, right) in enumerate(bounds[edges]):
        panel.axvspan(left, right, color="black", alpha=0.1, lw=0, label=None if order else "hidden")
    for index, (name, score) in enumerate(scores.items()):
        curve = score.total.mean(0)
        mean = curve[~hidden].mean().item()
        panel.step(
            minutes,
            to_array(curve),
            where="mid",
            color=method_colour(index),
            lw=1.0,
            zorder=3 - index / len(scores),  # the first one in front
            label=f"{name}, mean {mean:.1f}",
        )
    finish_gospa(panel, unit)
    return figure
