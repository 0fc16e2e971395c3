"""Compare tuning runs: `python experiments/tuning_curves.py gradient=RUN grid=RUN --figure=curves.png`."""

import argparse

from rich.table import Table

from studies.curves import curves_figure, read_curve
from torchdt.app.report.console import plain_console


def main() -> None:
    """Print how soon each run reaches the best value of every other one, and draw the curves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="NAME=DIRECTORY", help="run directories of tune.py")
    parser.add_argument("--figure", help="where to draw the curves")
    arguments = parser.parse_args()
    for run in arguments.runs:
        if "=" not in run:
            parser.error(f"found {run!r}, expected NAME=DIRECTORY")
    curves = {name: read_curve(path) for name, path in (run.split("=", 1) for run in arguments.runs)}
    table = Table("run", "passes", "best held-out", *(f"passes to best of {name}" for name in curves))
    for name, curve in curves.items():
        reached = [curve.passes_to(other.best[-1]) for other in curves.values()]
        cells = ["-" if passes is None else str(passes) for passes in reached]
        table.add_row(name, str(curve.passes[-1]), f"{curve.best[-1]:.4f}", *cells)
    plain_console().print(table)
    if arguments.figure:
        curves_figure(curves).savefig(arguments.figure, dpi=150)


if __name__ == "__main__":
    main()
