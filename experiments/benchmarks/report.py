"""What a benchmark measured: one row each, in `benchmark.csv`, in `benchmark.json` and printed."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import truediv
from pathlib import Path
from statistics import median
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from torchdt.app.report.csv_file import write_table
from torchdt.app.report.files import write_json

HIGH = 1e-3
"""Share of the largest power above which peaks are compared."""


@dataclass(frozen=True)
class Measured:
    """One number of a benchmark.

    Attributes:
        part: of the benchmark.
        quantity: what was measured, and of which method.
        value: NaN where it was left out.
        unit: of the value.
        note: how it was measured, where that does not go without saying.
    """

    part: str
    quantity: str
    value: float
    unit: str
    note: str = ""


class Plain(NamedTuple):
    """A plain formulation beside torchdt, in one step of data.

    Attributes:
        seconds: that it took.
        iterations: that it took.
        own_iterations: those of torchdt.
        peaks, own_peaks: cells of the high peaks, and those of torchdt.
    """

    seconds: float
    iterations: int
    own_iterations: int
    peaks: set[int]
    own_peaks: set[int]


def plain_rows(
    seconds: Sequence[float], plain: Sequence[Plain], iteration: float, few: int
) -> list[Measured]:
    """Times, ratios, iterations and peaks of torchdt and the plain formulations.

    Args:
        seconds: of torchdt in each step of data.
        plain: matrix products in the same steps.
        iteration: seconds of one with outer products.
        few: iterations with outer products that were timed.
    """
    products = [p.seconds for p in plain]
    outer = [iteration * p.iterations for p in plain]
    extrapolated = f"EXTRAPOLATED: {iteration:.3g} s, median of {few} iterations, x those of matrix products"
    double = "double precision, all columns in every iteration"
    union = sum(len(p.peaks | p.own_peaks) for p in plain)
    same = sum(p.peaks == p.own_peaks for p in plain)
    common = sum(len(p.peaks & p.own_peaks) for p in plain)
    rows: list[tuple[str, float, str, str]] = [
        ("NumPy, matrix products", median(products), "s/step", double),
        ("NumPy, outer products", median(outer), "s/step", extrapolated),
        ("matrix products / torchdt", median(map(truediv, products, seconds)), "ratio", "of every step"),
        ("outer products / torchdt", median(map(truediv, outer, seconds)), "ratio", "EXTRAPOLATED, likewise"),
        ("iterations of torchdt", median(p.own_iterations for p in plain), "per step", ""),
        ("iterations of matrix products", median(p.iterations for p in plain), "per step", ""),
        ("steps with identical peaks", same, f"of {len(plain)}", f"above {HIGH:g} of the largest power"),
        ("peaks in common", common, f"of {union}", "torchdt and matrix products, all steps"),
    ]
    return [Measured("sbl", *row) for row in rows]


def write_benchmark(directory: Path, machine: Mapping[str, object], rows: Sequence[Measured]) -> None:
    """Replace `benchmark.csv` and, with what is known of the machine, `benchmark.json`."""
    table = [asdict(row) for row in rows]
    write_json(directory / "benchmark.json", {"machine": machine, "rows": table})
    write_table(directory / "benchmark.csv", table)


def print_benchmark(console: Console, machine: Mapping[str, object], rows: Sequence[Measured]) -> None:
    """Print a table for each part, then what is known of the machine."""
    for part, group in itertools.groupby(rows, key=lambda row: row.part):
        table = Table(title=part)
        table.add_column("quantity")
        table.add_column("value", justify="right", no_wrap=True)
        table.add_column("unit", no_wrap=True)
        table.add_column("note")
        for row in group:
            value = "-" if math.isnan(row.value) else f"{row.value:.4g}"
            table.add_row(row.quantity, value, row.unit, row.note)
        console.print(table)
    facts = (f"{name} {v:.3g}" if isinstance(v, float) else f"{name} {v}" for name, v in machine.items())
    console.print("machine: " + ", ".join(facts), markup=False, highlight=False)
