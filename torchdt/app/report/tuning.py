"""What a tuning run leaves behind: tables, `tuned.yaml`, TensorBoard, figures of the likelihood."""

import os
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from omegaconf import OmegaConf

from torchdt.app.report.csv_file import write_csv
from torchdt.app.report.events import EventReport
from torchdt.app.report.figures import COLOURS
from torchdt.core.atomic import atomic_write
from torchdt.model.model import Model
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.fields import ENVIRONMENT
from torchdt.tuning.slices import Slice
from torchdt.tuning.state import Record, TuningState, Values, numbers

LAYOUT = {
    "Tuning": {
        "Log-likelihood per step, of training with the log-prior and held out": [
            "tuning/objective",
            "tuning/heldout",
        ],
        "GOSPA of the held-out set": ["heldout_gospa/total"],
        "Values": ["value/.*"],
        "Gradient norms": ["gradient_norm/.*"],
    }
}


def write_tuning_csv(path: str | os.PathLike[str], records: Sequence[Record]) -> None:
    """Write one row per step: what `Record` holds, vectors and gradient norms in columns of their own.

    Args:
        path: where to write, usually `tuning.csv`.
        records: one or more; what a step has not evaluated stays empty.
    """
    # The last step of an ascent takes no gradient, the first has what there is.
    norms = list(records[0].gradient_norms)
    own = ("step", "objective", "heldout", "skipped", "passes")
    header = [*own, *numbers(records[0].values), *(f"gradient_{name}" for name in norms)]

    def row(r: Record) -> list[object]:
        values = numbers(r.values).values()
        return [*(getattr(r, name) for name in own), *values, *map(r.gradient_norms.get, norms)]

    write_csv(path, header, map(row, records))


def tuning_summary(
    config: TuningConfig, state: TuningState, values: Values, gospa: tuple[float | None, float | None]
) -> dict[str, object]:
    """Content of `tuning.json`.

    Args:
        config: of the run.
        state: at its end.
        values: the best ones.
        gospa: mean of the held-out set before and after, None without truth.

    Returns:
        Log-likelihoods are per time step; `objective` is that of the training set with the log-prior.
    """
    best = next((r for r in state.records if r.heldout == state.best_heldout), state.records[0])
    first = state.records[0]
    return {
        "method": config.method,
        "steps": len(state.records),
        "passes": state.passes,
        "skipped": state.skipped,
        "best_step": best.step,
        "start": first.values,
        "best": values,
        "objective": {"before": first.objective, "after": best.objective},
        "heldout": {"before": first.heldout, "after": best.heldout},
        "heldout_gospa": {"before": gospa[0], "after": gospa[1]},
    }


def write_tuned(path: str | os.PathLike[str], values: Values, model: Model) -> None:
    """Write `tuned.yaml`, a configuration of `experiments/track.py` that differs by the tuned values alone.

    Args:
        path: where to write.
        values: by name; departures of the environment go into the field, a share of mismatch into the
            tracker, all others into the model.
        model: whose numbers they are.
    """
    path = Path(path)
    draw = {name: value for name, value in values.items() if name in ENVIRONMENT}
    content: dict[str, object] = {"defaults": ["track", "_self_"]}
    content["model"] = model.as_config(values)
    rest = {n: value for n, value in values.items() if n not in draw and n not in model.all_quantities()}
    if rest:
        content["tracker"] = rest
    if draw:
        content["field"] = {"draw": draw}
        content["calibration"] = {"enabled": False}
    command = f"torchdt track --config-dir={path.parent.resolve()} --config-name={path.stem}"
    header = f"# Tuned values, to combine with any scenario=... and other overrides:\n# {command}\n"
    with atomic_write(path) as file:
        file.write((header + OmegaConf.to_yaml(content)).encode())


def slice_figure(line: Slice) -> Figure:
    """Draw the training objective along one number, and where the slices cross."""
    figure = Figure(figsize=(4.5, 3.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(line.values, line.objective, "o-", color=COLOURS[0], markersize=4)
    axes.axvline(line.centre, color=COLOURS[1], linestyle="--", label=f"best: {line.centre:.4g}")
    if line.values[0] > 0 and line.values[-1] > 20 * line.values[0]:
        axes.set_xscale("log")
    axes.set_xlabel(line.name)
    axes.set_ylabel("Log-likelihood per step")
    axes.legend()
    return figure


class TuningReport(EventReport):
    """Writes a tuning run into event files; use it as a context manager.

    The tags: `tuning/objective`, `tuning/heldout`, `tuning/passes`, `tuning/skipped`, `value/<name>`,
    `gradient_norm/<name>`, `heldout_gospa/total`, `slices/<name>`, and one row under HPARAMS with the metrics
    `hparam/heldout` and `hparam/heldout_gospa`.

    Args:
        directory: folder of the event files, made if absent.
        first_step: first step that will be written; later ones of an earlier process, which ended before its
            checkpoint, are hidden.
    """

    def __init__(self, directory: str | os.PathLike[str], first_step: int = 0) -> None:
        super().__init__(directory, first_step, LAYOUT)

    def add_record(self, record: Record) -> None:
        """Write what one step found."""
        scalars = {
            "tuning/objective": record.objective,
            "tuning/heldout": record.heldout,
            "tuning/passes": record.passes,
            "tuning/skipped": record.skipped,
            **{f"value/{name}": value for name, value in numbers(record.values).items()},
            **{f"gradient_norm/{name}": norm for name, norm in record.gradient_norms.items()},
        }
        for tag, value in scalars.items():
            self.add_scalar(tag, value, record.step)

    def add_gospa(self, gospa: float | None, step: int) -> None:
        """Write the mean GOSPA of the held-out set, tracked with the best values of this step."""
        self.add_scalar("heldout_gospa/total", gospa, step)
