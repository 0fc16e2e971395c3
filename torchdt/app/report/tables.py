"""The table that closes a run."""

import math

from rich.console import Console
from rich.table import Table
from torch import Tensor

from torchdt.app.report.energy import energy_line, mean_shares
from torchdt.filter.history import TrackHistory
from torchdt.metrics import Gospa


def print_summary(
    console: Console, history: TrackHistory, gospa: Gospa | None, seconds: float, title: str = "Tracking"
) -> None:
    """Print one row per run and, for several runs, their mean.

    Columns: mean GOSPA over the steps and its parts, mean number of declared and of true objects, and the
    log-likelihood, `-` where a tracker does not know it; without truth those that need it are left out. The
    speed, in steps of all runs per second, goes below, and what the energy went to.

    Args:
        console: where to print.
        history: batch shape `(B,)`.
        gospa: `(B, K)`, or None without truth.
        seconds: wall-clock time of the tracking alone.
        title: above the table.
    """
    num_runs, num_steps = history.log_evidence.shape
    columns = {"declared": history.declared.sum(-1).double().mean(-1)}
    if gospa is not None:
        columns |= {"true": gospa.num_truth.double().mean(-1)}
        columns |= {"GOSPA": gospa.total.mean(-1), "localisation": gospa.localisation.mean(-1)}
        columns |= {"missed": gospa.missed.mean(-1), "false": gospa.false.mean(-1)}
    columns |= {"log-lik.": history.log_evidence.double().sum(-1)}

    speed = f"{num_runs * num_steps / seconds:.3g} steps/s" if seconds > 0 else "speed unknown"
    runs = "1 run" if num_runs == 1 else f"{num_runs} runs"
    caption = f"{runs} of {num_steps} steps in {seconds:.1f} s: {speed}"
    failed = int(history.failed.sum())
    caption += f"; {failed} broke down and count as missing" if failed else ""
    shares = mean_shares(history)
    caption += f"\n{energy_line(shares)}" if shares else ""
    table = Table(title=title, caption=caption, caption_justify="left")
    table.add_column("run", justify="right")
    for name in columns:
        table.add_column(name, justify="right")
    for run in range(num_runs):
        cells = (_cell(name, value[run]) for name, value in columns.items())
        table.add_row(str(run), *cells, end_section=run == num_runs - 1)
    if num_runs > 1:
        cells = (_cell(name, value.mean()) for name, value in columns.items())
        table.add_row("mean", *cells, style="bold")
    console.print(table)


def _cell(column: str, value: Tensor) -> str:
    number = value.item()
    digits = 1 if column == "log-lik." else 2
    return "-" if math.isnan(number) else f"{number:.{digits}f}"
