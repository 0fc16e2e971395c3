"""Turn run directories into one table and one figure: means over the seeds, grouped by what differs."""

import argparse
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import torch
from matplotlib.figure import Figure

from torchdt.app.report.collect import Row, interval_figure, print_rows, write_rows
from torchdt.app.report.collect_runs import Run, read_runs
from torchdt.app.report.console import plain_console, printable
from torchdt.app.suite import confidence
from torchdt.core.atomic import atomic_write
from torchdt.core.errors import InputError, StorageError

SHOWN = ("gospa", "log_likelihood", "heldout.after", "heldout_gospa.after", "direct.gospa", "mp_bp.gospa")


def find_directories(roots: Iterable[str | Path]) -> list[Path]:
    """Run directories in these and below, each once; numbered ones in the order of their numbers.

    Raises:
        InputError: where there is no such directory, or no run in it.
    """
    found: dict[Path, None] = {}
    for root in map(Path, roots):
        if not root.is_dir():
            raise InputError.of_path(root, "no such directory", "a run directory, or one of many runs")
        marks = [*root.rglob(".hydra"), *root.rglob("manifest.json")]
        here = {mark.parent for mark in marks}
        if not here:
            raise InputError.of_path(root, "no runs", "a run directory, or one of many runs")
        found |= dict.fromkeys(sorted(here, key=_in_order))
    return list(found)


def gather(directories: Iterable[Path]) -> tuple[list[Run], list[str]]:
    """Runs of these directories, and why others are left out.

    Raises:
        InputError: where none is left.
    """
    runs: list[Run] = []
    left_out: list[str] = []
    for directory in directories:
        try:
            runs += read_runs(directory)
        except InputError as error:
            left_out.append(str(error))
    if not runs:
        raise InputError("\n".join(["found no run that is complete:", *left_out]))
    return runs, left_out


def differing(runs: Sequence[Run]) -> list[str]:
    """Names of the settings that tell the runs apart, seeds and their number aside.

    What was set on the command line comes first. What follows from the names before it is left out: an option
    of a group, such as `scenario`, stands for all that it holds.
    """
    known = dict.fromkeys(name for run in runs for name in run.settings)
    names = [name for name in known if name.rpartition(".")[2] not in ("seed", "runs")]
    chosen = {name for run in runs for name in run.chosen}
    kept: list[str] = []
    for name in sorted(names, key=lambda name: name not in chosen):
        before, after, alone = (_count(runs, some) for some in (kept, [*kept, name], [name]))
        if after > before or (name in chosen and alone > 1):
            kept.append(name)
    return kept


def summarise(runs: Sequence[Run]) -> list[Row]:
    """One row for each setting, in the order in which they come."""
    names = differing(runs)
    metrics = dict.fromkeys(metric for run in runs for metric in run.metrics)
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(_setting(run, names), []).append(run)
    rows = []
    for group in groups.values():
        values = {
            metric: torch.tensor(
                [v for run in group for v in run.metrics.get(metric, ())], dtype=torch.float64
            )
            for metric in metrics
        }
        rows.append(
            Row(
                setting={name: group[0].settings.get(name) for name in names},
                runs=sum(run.sequences for run in group),
                means={metric: float(v.mean()) if len(v) else math.nan for metric, v in values.items()},
                intervals={metric: confidence(v) for metric, v in values.items()},
            )
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line: print the table, and write it and the figure where that is asked for.

    Args:
        arguments: of the command line; None takes those of the process.

    Raises:
        SystemExit: with status 1 and a message, where there is nothing to collect.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directories", nargs="+", metavar="DIR", help="run directories, or sweeps of them")
    parser.add_argument("--metric", action="append", help="to print and draw; several may be given")
    parser.add_argument("--csv", help="where to write the table, with all metrics")
    parser.add_argument("--figure", help="where to draw the first metric against what differs")
    options = parser.parse_args(arguments)
    try:
        runs, left_out = gather(find_directories(options.directories))
        rows = summarise(runs)
        metrics = choose(rows, options.metric)
        if options.csv:
            write_rows(options.csv, rows)
        if options.figure:
            write_figure(options.figure, interval_figure(rows, metrics[0]))
    except (InputError, StorageError) as error:
        parser.exit(1, printable(f"{parser.prog}: {error}\n"))
    print_rows(console := plain_console(), rows, metrics)
    for reason in left_out:
        console.print(f"left out: {printable(reason)}", style="red", highlight=False)


def write_figure(path: str, figure: Figure) -> None:
    """Write a figure in the format of the name's ending, such as `.png` or `.pdf`.

    Raises:
        InputError: where that is none.
    """
    kind, known = Path(path).suffix.removeprefix("."), figure.canvas.get_supported_filetypes()
    if kind not in known:
        raise InputError.of_path(path, f"ending '{kind}'", f"one of {', '.join(known)}")
    with atomic_write(path) as file:
        figure.savefig(file, format=kind, dpi=150)


def choose(rows: Sequence[Row], wanted: Sequence[str] | None) -> list[str]:
    """Metrics to show: those that are wanted, else the usual ones among those that there are.

    Raises:
        InputError: where the runs do not have one of them.
    """
    known = list(rows[0].means)
    for metric in wanted or ():
        if metric not in known:
            raise InputError.of_key("metric", metric, f"one of {', '.join(known)}")
    return list(wanted or [metric for metric in SHOWN if metric in known] or known[:1])


def _count(runs: Sequence[Run], names: Sequence[str]) -> int:
    return len({_setting(run, names) for run in runs})


def _setting(run: Run, names: Sequence[str]) -> str:
    """The values as text, in which 1 and 1.0 are the same."""
    values = json.dumps([run.settings.get(name) for name in names])
    return json.dumps(json.loads(values, parse_int=float))


def _in_order(path: Path) -> list[tuple[bool, int, str]]:
    return [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in path.parts]
