"""Scores of a suite of scenarios: one row each, in `quality.csv`, in `quality.json` and printed."""

import csv
import dataclasses
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from torchdt.app.report.files import write_json
from torchdt.core.atomic import atomic_write


@dataclass
class Quality:
    """Scores of one scenario; means are over runs and visible steps unless it says otherwise.

    Attributes:
        scenario: its name.
        error: what went wrong; empty where nothing did.
        runs, hidden: number of runs, and of hidden steps in each.
        gospa, gospa_ci: mean GOSPA and half its 95 % confidence interval over the runs (Student's t).
        localisation, missed, false: its parts.
        gospa_all, gospa_hidden: mean GOSPA over all steps, and over the hidden ones.
        count_error: mean absolute difference of the numbers of declared and true objects.
        switches: label switches per run (T-GOSPA), all steps.
        false_per_100: false estimates per 100 steps.
        birth_delay, drop_delay: medians of `TrackDelays` over the sources of all runs, steps.
        steps_per_second: of all runs together, tracking alone.
        real_time: how many times faster than the recording the tracking of all runs together is.
        seconds: calibration and tracking of all runs.
        gospa_by_run: mean GOSPA of each run, for paired comparisons.
    """

    scenario: str
    error: str = ""
    runs: int = 0
    hidden: int = 0
    gospa: float = math.nan
    gospa_ci: float = math.nan
    localisation: float = math.nan
    missed: float = math.nan
    false: float = math.nan
    gospa_all: float = math.nan
    gospa_hidden: float = math.nan
    count_error: float = math.nan
    switches: float = math.nan
    false_per_100: float = math.nan
    birth_delay: float = math.nan
    drop_delay: float = math.nan
    steps_per_second: float = math.nan
    real_time: float = math.nan
    seconds: float = math.nan
    gospa_by_run: list[float] = dataclasses.field(default_factory=list)


TABLES = {
    "GOSPA": {
        "gospa": "mean",
        "gospa_ci": "± 95 %",
        "localisation": "local.",
        "missed": "missed",
        "false": "false",
        "gospa_all": "all steps",
        "gospa_hidden": "hidden",
    },
    "Tracks": {
        "count_error": "count error",
        "switches": "switches",
        "false_per_100": "false/100",
        "birth_delay": "birth delay",
        "drop_delay": "drop delay",
    },
    "Speed": {
        "runs": "runs",
        "steps_per_second": "steps/s",
        "real_time": "x real time",
        "seconds": "seconds",
    },
}


def write_rows(directory: Path, rows: Sequence[Quality]) -> None:
    """Replace `quality.csv` and `quality.json`."""
    table = [dataclasses.asdict(row) for row in rows]
    write_json(directory / "quality.json", {"scenarios": table})
    write_table(directory / "quality.csv", table)


def write_table(path: str | os.PathLike[str], rows: Sequence[Mapping[str, object]]) -> None:
    """Write a CSV file with the columns of the first row; lists are left out."""
    columns = [key for key, value in rows[0].items() if not isinstance(value, list)]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_write(path) as file:
        file.write(buffer.getvalue().encode())


def print_rows(console: Console, rows: Sequence[Quality]) -> None:
    """Print the tables, then what failed."""
    for title, columns in TABLES.items():
        table = Table(title=title)
        table.add_column("scenario")
        for header in columns.values():
            table.add_column(header, justify="right")
        for row in rows:
            values = (getattr(row, name) for name in columns)
            table.add_row(row.scenario, *("-" if math.isnan(v) else f"{v:.3g}" for v in values))
        console.print(table)
    for row in rows:
        if row.error:
            console.print(f"{row.scenario} failed: {row.error}", style="bold red", markup=False)
