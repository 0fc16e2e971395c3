"""Table, figure and files of the study of detection."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from torch import Tensor

from studies.declared import Estimate, level_of_half, rate, share
from torchdt.app.report.csv_file import write_csv
from torchdt.app.report.events import EventReport
from torchdt.app.report.figures import COLOURS, MARKERS
from torchdt.app.report.files import write_figures, write_json

BOUND = "told the track"
COLUMNS = ("tracker", "level_db", "within", "runs", "declared", "probability", "low", "high")


class Detections(NamedTuple):
    """What one tracker has declared.

    Attributes:
        first: `(L, R)` steps until the source is declared in R sequences of each of L levels, infinity for
            never.
        num_false: tracks declared in noise alone.
        hours: of noise alone.
    """

    first: Tensor
    num_false: int
    hours: float

    def within(self, steps: int) -> list[Estimate]:
        """Probability of being declared within so many steps, for each level."""
        counts = (self.first <= steps).sum(-1).tolist()
        return [share(count, self.first.shape[-1]) for count in counts]

    def half(self, levels: Sequence[float], steps: int) -> float:
        """Level of one half within so many steps; NaN where the levels do not reach it."""
        return level_of_half(levels, [estimate.value for estimate in self.within(steps)])

    def median_first(self) -> list[float | None]:
        """Median of the step that first declares the source, for each level; None where half never do."""
        medians = self.first.quantile(0.5, -1, interpolation="higher").tolist()
        return [median if math.isfinite(median) else None for median in medians]

    @property
    def false_per_hour(self) -> Estimate:
        """Tracks in noise alone, per hour."""
        return rate(self.num_false, self.hours)


class Report(NamedTuple):
    """The trackers of the study, beside the bound.

    Attributes:
        levels: of the source, dB per element, rising.
        within: numbers of steps.
        shown: that of table and figure.
        found: by the name of the tracker; `BOUND` is one of them.
    """

    levels: Sequence[float]
    within: Sequence[int]
    shown: int
    found: Mapping[str, Detections]

    def summary(self) -> dict[str, dict[str, object]]:
        """Levels of one half, their distance to the bound, dB, and false tracks, by tracker."""
        bound = self.found[BOUND]
        content: dict[str, dict[str, object]] = {}
        for name, detections in self.found.items():
            half = {steps: detections.half(self.levels, steps) for steps in self.within}
            content[name] = {
                "level_of_half_db": half,
                "median_first_step": dict(zip(self.levels, detections.median_first(), strict=True)),
                "from_bound_db": {s: v - bound.half(self.levels, s) for s, v in half.items()},
                "false_tracks": detections.num_false,
                "false_per_hour": list(detections.false_per_hour),
            }
        return content


def write_tables(directory: Path, report: Report) -> None:
    """Replace `detection.csv` and `detection.json`."""
    rows = [
        (name, level, steps, d.first.shape[-1], int((first <= steps).sum()), *estimate)
        for name, d in report.found.items()
        for steps in report.within
        for level, first, estimate in zip(report.levels, d.first, d.within(steps), strict=True)
    ]
    write_csv(directory / "detection.csv", COLUMNS, rows)
    write_json(directory / "detection.json", {"levels_db": report.levels, "trackers": report.summary()})


def write_figure(directory: Path, report: Report, tensorboard: bool) -> None:
    """Write `figures/detection.png`, and event files where these are wanted."""
    figure = detection_figure(report)
    write_figures(directory / "figures", {"detection": figure})
    if tensorboard:
        write_events(directory / "tensorboard", report, figure)


def write_events(directory: Path, report: Report, figure: Figure) -> None:
    """The figure, and for each level a chart of the shares declared so far over the steps."""
    names = [f"level_{level:g}_dB" for level in report.levels]
    layout = {"Declared": {name: [f"{name}/.*"] for name in names}}
    last = max(report.within)
    with EventReport(directory, 0, layout) as events:
        events.add_figure("detection", figure)
        for tracker, detections in report.found.items():
            so_far = detections.first[..., None] <= torch.arange(1, last + 1)
            for name, curve in zip(names, so_far.double().mean(1).tolist(), strict=True):
                for step, value in enumerate(curve, start=1):
                    events.add_scalar(f"{name}/{tracker.replace(' ', '_')}", value, step)


def print_report(console: Console, report: Report) -> None:
    """Print probabilities over the levels, and what follows from them, a column for each tracker."""
    table = Table(
        title=f"Share of sources declared within {report.shown} steps",
        caption="50 %: level of one half; false: tracks per hour of noise, and the end of its 95 % interval",
    )
    table.add_column("level", no_wrap=True)
    for name in report.found:
        table.add_column(name, justify="right", no_wrap=True)
    shares = [detections.within(report.shown) for detections in report.found.values()]
    for level, row in zip(report.levels, zip(*shares, strict=True), strict=True):
        table.add_row(f"{level:g} dB", *(f"{estimate.value:.2f}" for estimate in row))
    table.add_section()
    halves = [detections.half(report.levels, report.shown) for detections in report.found.values()]
    bound = report.found[BOUND].half(report.levels, report.shown)
    table.add_row("50 %, dB", *map(_decibel, halves))
    table.add_row("from bound, dB", *(_decibel(half - bound) for half in halves))
    false = [detections.false_per_hour for detections in report.found.values()]
    table.add_row("false/h", *(f"{estimate.value:.2g} (to {estimate.high:.3g})" for estimate in false))
    console.print(table)


def detection_figure(report: Report) -> Figure:
    """Probability over level, a line for each tracker, with 95 % intervals; the bound in black."""
    figure = Figure(figsize=(7.2, 3.8), layout="constrained")
    axes = figure.subplots()
    others = [name for name in report.found if name != BOUND]
    for name, detections in report.found.items():
        estimates = detections.within(report.shown)
        index = others.index(name) if name in others else None
        colour = "black" if index is None else COLOURS[index % len(COLOURS)]
        axes.plot(
            report.levels,
            [estimate.value for estimate in estimates],
            color=colour,
            marker="" if index is None else MARKERS[index % len(MARKERS)],
            linestyle="--" if index is None else "-",
            label=name,
        )
        low, high = ([getattr(estimate, end) for estimate in estimates] for end in ("low", "high"))
        axes.fill_between(report.levels, low, high, color=colour, alpha=0.1, linewidth=0)
    axes.axhline(0.5, color="black", alpha=0.3, linewidth=0.8)
    axes.set_xlabel("Level per element, tone and snapshot (dB)")
    axes.set_ylabel(f"Declared within {report.shown} steps")
    axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper")
    return figure


def _decibel(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f}"
