"""Many runs in one table and one figure: a row for each setting, means with their confidence intervals."""

import json
import math
import os
from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from torchdt.app.report.csv_file import write_table
from torchdt.app.report.figures import COLOURS, MARKERS


class Row(NamedTuple):
    """Runs of one setting.

    Attributes:
        setting: values by name of what differs between the rows; nothing for a single row.
        runs: number of sequences.
        means, intervals: of each metric, and half the 95 % confidence interval; NaN where unknown.
    """

    setting: dict[str, object]
    runs: int
    means: dict[str, float]
    intervals: dict[str, float]

    @property
    def label(self) -> str:
        """The setting in words."""
        return ", ".join(f"{name}={text(value)}" for name, value in self.setting.items()) or "all runs"


def text(value: object) -> str:
    """A setting as it is written on the command line."""
    return value if isinstance(value, str) else json.dumps(value)


def write_rows(path: str | os.PathLike[str], rows: Sequence[Row]) -> None:
    """Write a CSV file: the setting, `runs`, and `NAME` and `NAME_ci` of each metric."""
    table: list[dict[str, object]] = []
    for row in rows:
        content: dict[str, object] = {name: text(value) for name, value in row.setting.items()}
        content["runs"] = row.runs
        for metric, mean in row.means.items():
            content |= {metric: mean, f"{metric}_ci": row.intervals[metric]}
        table.append(content)
    write_table(path, table)


def print_rows(console: Console, rows: Sequence[Row], metrics: Sequence[str]) -> None:
    """Print the setting, the number of runs, and these metrics."""
    table = Table(caption="± half the 95 % confidence interval over the runs", caption_justify="left")
    for name in rows[0].setting:
        table.add_column(name)
    for name in ("runs", *metrics):
        table.add_column(name, justify="right")
    for row in rows:
        cells = (_cell(row.means[metric], row.intervals[metric]) for metric in metrics)
        table.add_row(*map(text, row.setting.values()), str(row.runs), *cells)
    console.print(table)


def interval_figure(rows: Sequence[Row], metric: str) -> Figure:
    """Draw a metric against what differs.

    Where one of the settings that differ is a number, it is the axis, with a curve for each combination of
    the others; otherwise each row has a place of its own.
    """
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    axes = figure.subplots()
    numeric = [name for name in rows[0].setting if all(_is_number(row.setting[name]) for row in rows)]
    if len(numeric) == 1:
        (axis,) = numeric
        curves: dict[str, list[Row]] = {}
        for row in rows:
            rest = {name: value for name, value in row.setting.items() if name != axis}
            curves.setdefault(row._replace(setting=rest).label, []).append(row)
        for index, (label, members) in enumerate(curves.items()):
            members = sorted(members, key=lambda row: _number(row, axis))
            places = [_number(row, axis) for row in members]
            _errorbar(axes, places, members, metric, index, _literal(label))
        axes.set_xlabel(_literal(axis))
        values = [_number(row, axis) for row in rows]
        if 0 < 20 * min(values) < max(values):
            axes.set_xscale("log")
        if len(curves) > 1:
            axes.legend()
    else:
        _errorbar(axes, list(range(len(rows))), rows, metric, linestyle="none")
        axes.set_xticks(
            range(len(rows)),
            [_literal(row.label).replace(", ", "\n") for row in rows],
            rotation=30,
            ha="right",
        )
    axes.set_ylabel(_literal(metric))
    axes.grid(alpha=0.3)
    return figure


def _errorbar(
    axes: Axes,
    places: Sequence[float],
    rows: Sequence[Row],
    metric: str,
    index: int = 0,
    label: str | None = None,
    linestyle: str = "-",
) -> None:
    axes.errorbar(
        places,
        [row.means[metric] for row in rows],
        [0.0 if math.isnan(row.intervals[metric]) else row.intervals[metric] for row in rows],
        color=COLOURS[index % len(COLOURS)],
        marker=MARKERS[index // len(COLOURS) % len(MARKERS)],
        linestyle=linestyle,
        capsize=3,
        label=label,
    )


def _cell(mean: float, interval: float) -> str:
    if math.isnan(mean):
        return "-"
    return f"{mean:.4g}" if math.isnan(interval) else f"{mean:.4g} ± {interval:.2g}"


def _literal(name: str) -> str:
    """A name that Matplotlib takes for no formula."""
    return name.replace("$", r"\$")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(row: Row, name: str) -> float:
    value = row.setting[name]
    assert isinstance(value, int | float)
    return value
