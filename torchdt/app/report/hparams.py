"""A tracking run as one row of TensorBoard's table of hyperparameters."""

from collections.abc import Mapping, Sequence
from typing import Any

from torchdt.run.checkpoint import flatten

PLAIN = ("seed", "runs", "dtype")
Scalar = bool | int | float | str


def row_settings(config: Mapping[str, object], tracker: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Settings of a run that its row shows, by the names they have on the command line.

    They are the scenario, the tracker and the model with all of their numbers, the seed, the number of runs,
    the dtype, and whatever was given on the command line: that is what differs between the jobs of a sweep.

    Args:
        config: resolved, of plain containers and values.
        tracker: its name.
        overrides: as given on the command line, `key=value`.
    """
    flat = flatten(config)
    scalars = {name: value for name, value in flat.items() if isinstance(value, Scalar)}
    row = {"scenario": scalars["scenario.name"], "tracker": tracker}
    row |= {
        name: v for name, v in scalars.items() if name in PLAIN or name.startswith(("tracker.", "model."))
    }
    for override in overrides:
        name, _, text = override.lstrip("+").partition("=")
        if not name.startswith(("~", "logging", "hydra")):
            row.setdefault(name, scalars.get(name, text))
    return row


def row_metrics(summary: Mapping[str, Any], declared: float) -> dict[str, float | None]:
    """Results of a run that its row shows: means over all sequences and steps.

    Args:
        summary: content of `metrics.json`, see `torchdt.app.report.files.metrics_summary`.
        declared: mean number of declared objects.

    Returns:
        GOSPA and its parts, None without truth; declared objects; log-likelihood per step; seconds; steps per
        second.
    """
    scores = summary["gospa"] or dict.fromkeys(("mean", "localisation", "missed", "false"))
    return {
        "gospa": scores["mean"],
        **{part: scores[part] for part in ("localisation", "missed", "false")},
        "declared": declared,
        "log_likelihood_per_step": summary["log_likelihood"] / summary["num_steps"],
        "seconds": summary["seconds"],
        "steps_per_second": summary["steps_per_second"],
    }
