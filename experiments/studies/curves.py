"""Held-out likelihood of several tuning runs over the passes of the filter they have used."""

import csv
import os
from collections.abc import Mapping
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from torchdt.app.report.figures import COLOURS
from torchdt.core.errors import InputError


class Curve(NamedTuple):
    """Best held-out log-likelihood per step so far, whenever it was evaluated, and at the end.

    Attributes:
        passes: runs of the filter used, rising; a gradient counts three.
        best: the largest value until then.
    """

    passes: list[int]
    best: list[float]

    def passes_to(self, value: float) -> int | None:
        """Passes after which a value is reached; None if it never is."""
        return next((p for p, b in zip(self.passes, self.best, strict=True) if b >= value), None)


def read_curve(directory: str | os.PathLike[str]) -> Curve:
    """Curve of one run directory of `experiments/tune.py`.

    Raises:
        InputError: where the directory has no `tuning.csv` or that has no held-out values.
    """
    path = Path(directory) / "tuning.csv"
    if not path.is_file():
        raise InputError.of_path(path, "no such file", "the table of a tuning run")
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    held = [row for row in rows if row.get("heldout")]
    if not held:
        raise InputError.of_path(path, "no held-out values", "the table of a tuning run")
    best = list(accumulate((float(row["heldout"]) for row in held), max))
    return Curve([int(row["passes"]) for row in (*held, rows[-1])], [*best, best[-1]])


def curves_figure(curves: Mapping[str, Curve]) -> Figure:
    """Draw curves by their names."""
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for index, (name, curve) in enumerate(curves.items()):
        colour = COLOURS[index % len(COLOURS)]
        axes.step(curve.passes, curve.best, where="post", color=colour, label=name)
        axes.plot(curve.passes[-1], curve.best[-1], "o", color=colour, markersize=4)
    axes.set_xlabel("Passes of the filter over a set")
    axes.set_ylabel("Best held-out log-likelihood per step")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
