"""Figure of a benchmark: how time grows with size, and what a step is made of."""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.report import Measured
from torchdt.app.report.figures import COLOURS, legend_outside

EXPONENT = "exponent of "


class Curve(NamedTuple):
    """How time grows with one size.

    Attributes:
        sizes: rising.
        times: milliseconds.
        exponent: fitted.
    """

    sizes: list[int]
    times: list[float]
    exponent: float


def benchmark_figure(rows: Sequence[Measured]) -> Figure | None:
    """Scaling curves of part `scaling` above the parts of a step of part `step`; None without either.

    Args:
        rows: all that was measured.
    """
    curves, bars = scaling_curves(rows), step_bars(rows)
    heights = [3.6] * bool(curves) + [0.6 + 0.26 * len(bars)] * bool(bars)
    if not heights:
        return None
    figure = Figure(figsize=(7.2, sum(heights)), layout="constrained")
    panels = list(figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])
    if curves:
        draw_curves(panels[0], curves)
    if bars:
        draw_bars(panels[-1], bars)
    return figure


def scaling_curves(rows: Sequence[Measured]) -> dict[str, Curve]:
    """Curves by what grows, from rows `AXIS = SIZE` and `exponent of AXIS`."""
    values = {row.quantity: row.value for row in rows if row.part == "scaling"}
    curves = {
        name.removeprefix(EXPONENT): Curve([], [], value)
        for name, value in values.items()
        if name.startswith(EXPONENT)
    }
    for name, value in values.items():
        axis, is_point, size = name.partition(" = ")
        if is_point:
            curves[axis].sizes.append(int(size))
            curves[axis].times.append(value)
    return curves


def step_bars(rows: Sequence[Measured]) -> dict[str, float]:
    """Milliseconds of the parts of a step."""
    return {row.quantity: row.value for row in rows if row.part == "step" and row.unit == "ms"}


def draw_curves(panel: Axes, curves: dict[str, Curve]) -> None:
    """Time over size, both logarithmic, with fitted exponents in the legend."""
    for index, (axis, curve) in enumerate(curves.items()):
        colour = COLOURS[index % len(COLOURS)]
        label = f"{axis}: {curve.exponent:.2f}"
        panel.loglog(curve.sizes, curve.times, "o-", ms=4, lw=1.2, color=colour, label=label)
    panel.set_xlabel("Size")
    panel.set_ylabel("Time (ms)")
    panel.grid(alpha=0.3)
    legend_outside(panel)


def draw_bars(panel: Axes, bars: dict[str, float]) -> None:
    """One bar for each part, the first on top; parts contain one another."""
    drawn = panel.barh(list(bars), list(bars.values()), color=COLOURS[0])
    panel.bar_label(drawn, fmt="%.3g", padding=3)
    panel.set_xlabel("Time (ms)")
    panel.invert_yaxis()
    panel.margins(x=0.15)
    panel.grid(axis="x", alpha=0.3)
