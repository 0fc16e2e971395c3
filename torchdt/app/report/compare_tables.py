"""Scores of several trackers in a suite of scenarios: `compare.csv`, `compare.json`, event files, printed."""

import dataclasses
import itertools
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from torch import Tensor

from torchdt.app.report.csv_file import write_table
from torchdt.app.report.events import EventReport
from torchdt.app.report.files import seconds, write_json
from torchdt.app.report.scores import Quality
from torchdt.metrics import Gospa


@dataclass
class Comparison(Quality):
    """Scores of one tracker in one scenario, and how they compare with those of the first tracker.

    Attributes:
        tracker: its name.
        ahead: share of this tracker's GOSPA by which the first one's is lower, `1 - first / this`; negative
            where the first one's is higher, NaN where this one's is zero.
        difference, difference_ci: mean of GOSPA less that of the first tracker in the same run, and half its
            95 % confidence interval over the runs (Student's t).
    """

    tracker: str = ""
    ahead: float = math.nan
    difference: float = math.nan
    difference_ci: float = math.nan


COLUMNS = {
    "localisation": "local.",
    "missed": "missed",
    "false": "false",
    "gospa_all": "all\nsteps",
    "false_per_100": "false\n/100",
    "switches": "switches",
    "steps_per_second": "steps\n/s",
}


METRICS = ("gospa", "localisation", "missed", "false", "gospa_all", "switches", "seconds", "steps_per_second")
"""Scores in the row of a tracker under HPARAMS."""


def write_comparison(directory: Path, rows: Sequence[Comparison]) -> None:
    """Replace `compare.csv` and `compare.json`."""
    table = [{"scenario": row.scenario, "tracker": row.tracker} | dataclasses.asdict(row) for row in rows]
    write_json(directory / "compare.json", {"rows": table})
    write_table(directory / "compare.csv", table)


def write_gospa_table(path: str | os.PathLike[str], scores: Mapping[str, Gospa], times: Tensor) -> None:
    """Write one row per tracker, run and step, the last two counted from zero.

    Args:
        path: where to write, usually `gospa.csv`.
        scores: `(B, K)` by the tracker's name, one or more.
        times: `(B, K)` of the steps, s, see `Recording.times`.
    """
    names = ("gospa", *Gospa._fields[1:])
    rows: list[dict[str, object]] = []
    time = seconds(times)
    for tracker, score in scores.items():
        parts = [part.tolist() for part in score]
        for run, step in itertools.product(*map(range, score.total.shape)):
            rows.append({"tracker": tracker, "run": run, "step": step, "time_s": time[run][step]})
            rows[-1] |= {name: part[run][step] for name, part in zip(names, parts, strict=True)}
    write_table(path, rows)


def write_events(
    directory: str | os.PathLike[str], tracker: str, quality: Quality, score: Gospa, seed: int
) -> None:
    """Write GOSPA and its parts over time, means over the runs, for TensorBoard to lay over each other.

    What was in the folder before is hidden. The tags are those of a single run: `gospa/total`,
    `gospa/localisation`, `gospa/missed`, `gospa/false`; and there is one row under HPARAMS.

    Args:
        directory: folder of the event files of one tracker, made if absent.
        tracker: its name.
        quality: scores of all its runs.
        score: `(B, K)`.
        seed: of the first run.
    """
    settings = {"scenario": quality.scenario, "tracker": tracker, "runs": quality.runs, "seed": seed}
    with EventReport(directory, 0, {"Quality": {"GOSPA and its parts": ["gospa/.*"]}}) as report:
        for name in ("total", "localisation", "missed", "false"):
            for step, value in enumerate(getattr(score, name).mean(0).tolist()):
                report.add_scalar(f"gospa/{name}", value, step)
        metrics = {name: getattr(quality, name) for name in METRICS}
        report.add_hparams(settings, metrics, score.total.shape[-1] - 1)


def print_comparison(console: Console, rows: Sequence[Comparison]) -> None:
    """Print a table for each scenario, then what failed."""
    for scenario, group in itertools.groupby(rows, key=lambda row: row.scenario):
        block = list(group)
        caption = f"ahead: by how much of a tracker's GOSPA that of {block[0].tracker} is lower"
        # Narrow enough for 80 characters, the width of a log.
        table = Table(title=scenario, caption=caption, box=SIMPLE_HEAD, show_edge=False, padding=0)
        table.add_column("tracker", no_wrap=True)
        table.add_column("GOSPA ± 95 %", justify="right", no_wrap=True)
        for header in (*COLUMNS.values(), "ahead"):
            table.add_column(header, justify="right", no_wrap=True)
        for row in block:
            total = f"{_number(row.gospa)} ± {_number(row.gospa_ci)}"
            values = (_number(getattr(row, name)) for name in COLUMNS)
            ahead = "-" if math.isnan(row.ahead) else f"{row.ahead:.0%}"
            table.add_row(row.tracker, total, *values, ahead)
        console.print(table)
    for row in rows:
        if row.error:
            console.print(
                f"{row.scenario}, {row.tracker} failed: {row.error}", style="bold red", markup=False
            )


def _number(value: float) -> str:
    """At most five characters, up to 99999."""
    if math.isnan(value):
        return "-"
    return f"{value:.2f}" if abs(value) < 99.995 else f"{value:.0f}"
