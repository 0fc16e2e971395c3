"""What a run directory holds, for tables over many runs: settings and scores."""

import csv
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import OmegaConf

from torchdt.checkpoint import flatten
from torchdt.errors import InputError
from torchdt.model.parameters import Parameters

SCORES = ("gospa", "localisation", "missed", "false")
# Of the files that hold scores, what is none; GOSPA comes from its table, where each sequence has its own.
RESULTS = {
    "metrics.json": ("tracker", "num_steps", "num_runs", "seed", *SCORES),
    "tuning.json": ("method", "start", "best", "best_step"),
    "tart.json": (),
}


class Run(NamedTuple):
    """One setting in one run directory.

    Attributes:
        settings: by dotted names, those of groups (`tracker`) first: their option.
        chosen: names that were set on the command line.
        metrics: values by name, one for each sequence or one for all of them; no name without values.
        sequences: number of them that were tracked together.
    """

    settings: dict[str, object]
    chosen: set[str]
    metrics: dict[str, list[float]]
    sequences: int


def read_runs(directory: Path) -> list[Run]:
    """Read what `experiments/track.py`, `tune.py` or `tart.py` left in a directory: a run for each variant.

    Metrics are `gospa`, `localisation`, `missed` and `false` of each sequence, and the numbers of
    `metrics.json`, `tuning.json` and `tart.json` by dotted names (`heldout.after`).

    Raises:
        InputError: where the job failed or has not ended, or a file is not what such a run writes.
    """
    job = _read_json(directory / "job.json")
    if job and job["status"] != "completed":
        raise InputError(f"path '{directory}': {job.get('error') or 'the job has not ended'}")
    contents = {name: _read_json(directory / name) for name in RESULTS}
    if not any(contents.values()):
        raise InputError.of_path(directory, "no results", f"one of {', '.join(RESULTS)}")
    metrics = {
        key: [float(value)]
        for name, left_out in RESULTS.items()
        for key, value in flatten(contents[name]).items()
        if isinstance(value, int | float) and key.partition(".")[0] not in left_out
    }
    settings, chosen = _read_settings(directory)
    scores = _read_scores(directory / "gospa.csv")
    sequences = contents["metrics.json"].get("num_runs", 1)
    variants = _read_csv(directory / "variants.csv")
    if variants:
        return _split(Run(settings, chosen, scores, sequences), variants)
    return [Run(settings, chosen, scores | metrics, sequences)]


def _read_settings(directory: Path) -> tuple[dict[str, object], set[str]]:
    """Settings and the names among them that were set; choices of groups are not in the manifest."""
    settings: dict[str, object] = {}
    chosen: set[str] = set()
    hydra = directory / ".hydra" / "hydra.yaml"
    if hydra.is_file():
        content = OmegaConf.load(hydra).hydra
        options = ((str(group), option) for group, option in content.runtime.choices.items())
        settings = {group: o for group, o in options if not group.startswith(("hydra/", "experiment"))}
        chosen = {str(override).lstrip("+~").partition("=")[0] for override in content.overrides.task}
    flat = flatten(_read_json(directory / "manifest.json").get("config", {}))
    return settings | {name: value for name, value in flat.items() if name not in settings}, chosen


def _split(run: Run, variants: list[dict[str, str]]) -> list[Run]:
    """The variants of a run, whose sequences lie variant by variant."""
    settings = {key: value for key, value in run.settings.items() if key != "variants"}
    size = run.sequences // len(variants)
    runs = []
    for index, row in enumerate(variants):
        own = {f"tracker.{name}": _value(row[name]) for name in Parameters._fields}
        part = slice(index * size, (index + 1) * size)
        metrics = {name: values[part] for name, values in run.metrics.items()}
        likelihood = float(row["log_likelihood"])
        metrics |= {"log_likelihood": [likelihood]} if math.isfinite(likelihood) else {}
        runs.append(Run(settings | own, run.chosen | set(own), metrics, size))
    return runs


def _read_scores(path: Path) -> dict[str, list[float]]:
    """Means over the steps of each sequence; nothing without truth."""
    by_run: dict[str, list[dict[str, str]]] = {}
    for row in _read_csv(path):
        by_run.setdefault(row["run"], []).append(row)
    names = SCORES if by_run else ()
    return {n: [sum(float(row[n]) for row in rows) / len(rows) for rows in by_run.values()] for n in names}


def _value(cell: str) -> object:
    """A cell of `variants.csv`: a number, a list or nothing."""
    return json.loads(cell) if cell else None


def _read_csv(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _read_json(path: Path) -> dict[str, Any]:
    """Nothing where there is no file.

    Raises:
        InputError: where the file holds something else than a JSON object.
    """
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text()))
    except (ValueError, TypeError) as error:
        raise InputError.of_path(path, error, "a JSON object") from error
