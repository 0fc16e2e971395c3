"""What a run directory holds, for tables over many runs: settings and scores."""

import csv
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import OmegaConf

from torchdt.core.errors import InputError
from torchdt.run.checkpoint import flatten

SCORES = ("gospa", "localisation", "missed", "false")
# Of the files that hold scores, what is none; GOSPA comes from its table, where each sequence has its own.
RESULTS = {
    "metrics.json": ("tracker", "num_steps", "num_runs", "seed", *SCORES),
    "tuning.json": ("method", "start", "best", "best_step"),
    "tart.json": (),
}

DEEPEST = 50
"""Levels of nesting that a setting or a score may have."""


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
    if job and job.get("status") != "completed":
        raise InputError(f"path '{directory}': {job.get('error') or 'the job has not ended'}")
    contents = {name: _read_json(directory / name) for name in RESULTS}
    metrics: dict[str, list[float]] = {}
    for name, left_out in RESULTS.items():
        with _reading(directory / name, "numbers"):
            metrics |= {
                key: [float(value)]
                for key, value in flatten(contents[name]).items()
                if isinstance(value, int | float) and key.partition(".")[0] not in left_out
            }
    settings, chosen = _read_settings(directory)
    counts = contents["metrics.json"]
    sequences = _count(directory, counts, "num_runs")
    scores = _read_scores(directory / "gospa.csv", sequences, _count(directory, counts, "num_steps"))
    if not metrics and not scores:
        raise InputError.of_path(directory, "no results", f"one of {', '.join(RESULTS)}")
    variants = directory / "variants.csv"
    if settings.get("variants") or variants.is_file():
        return _read_variants(variants, Run(settings, chosen, scores, sequences))
    return [Run(settings, chosen, scores | metrics, sequences)]


def _count(directory: Path, counts: dict[str, Any], key: str) -> int:
    """A count of `metrics.json`; jobs that do not track a batch have none, which is one."""
    number = counts.get(key, 1)
    if not isinstance(number, int) or number < 1:
        raise InputError.of_path(directory / "metrics.json", f"{key} {number!r}", "a positive integer")
    return number


def _read_settings(directory: Path) -> tuple[dict[str, object], set[str]]:
    """Settings and the names among them that were set; choices of groups are not in the manifest."""
    settings: dict[str, object] = {}
    chosen: set[str] = set()
    hydra = directory / ".hydra" / "hydra.yaml"
    if hydra.is_file():
        with _reading(hydra, "the settings of Hydra"):
            content = OmegaConf.load(hydra).hydra
            options = ((str(group), option) for group, option in content.runtime.choices.items())
            settings = {
                group: option if option is None else str(option)
                for group, option in options
                if not group.startswith(("hydra/", "experiment"))
            }
            chosen = {str(override).lstrip("+~").partition("=")[0] for override in content.overrides.task}
            _check_plain([settings, *chosen])
    manifest = _read_json(directory / "manifest.json")
    with _reading(directory / "manifest.json", "an object 'config'"):
        flat = flatten(dict(manifest.get("config", {})))
    return settings | {name: value for name, value in flat.items() if name not in settings}, chosen


def _read_variants(path: Path, run: Run) -> list[Run]:
    """The variants of a run, whose sequences lie variant by variant."""
    settings = {key: value for key, value in run.settings.items() if key != "variants"}
    runs: list[Run] = []
    with _reading(path, "a row for each variant, with its values"):
        variants = _read_csv(path, ("survival", "log_likelihood"))
        names = [name for name in (variants or [{}])[0] if name not in ("variant", *SCORES, "log_likelihood")]
        asked = run.settings.get("variants")
        number = len(asked) if isinstance(asked, list) else len(variants)
        if not len(variants) == number > 0 or run.sequences % number:
            found = f"{len(variants)} rows for {run.sequences} sequences"
            raise InputError.of_path(path, found, f"one for each of {number} variants")
        size = run.sequences // number
        for index, row in enumerate(variants):
            own = {_key_of(name, settings): _value(row[name]) for name in names}
            part = slice(index * size, (index + 1) * size)
            metrics = {name: values[part] for name, values in run.metrics.items()}
            likelihood = float(row["log_likelihood"])
            metrics |= {"log_likelihood": [likelihood]} if math.isfinite(likelihood) else {}
            runs.append(Run(settings | own, run.chosen | set(own), metrics, size))
    return runs


def _key_of(name: str, settings: Mapping[str, object]) -> str:
    """Key under which a run has a number of the model."""
    held = (key for key in settings if key.startswith("model.") and key.endswith(f".{name}"))
    return next(held, f"model.{name}")


def _read_scores(path: Path, sequences: int, num_steps: int) -> dict[str, list[float]]:
    """Means over the steps of each sequence; nothing without truth."""
    if not path.is_file():
        return {}
    by_run: dict[str, list[dict[str, str]]] = {}
    with _reading(path, "a row for each sequence and step, with its scores"):
        for row in _read_csv(path, ("run", *SCORES)):
            by_run.setdefault(row["run"], []).append(row)
        scores = {
            n: [sum(float(row[n]) for row in rows) / len(rows) for rows in by_run.values()] for n in SCORES
        }
    found = [len(rows) for rows in by_run.values()]
    if found != [num_steps] * sequences:
        raise InputError.of_path(path, f"{sum(found)} rows", f"{num_steps} for each of {sequences} sequences")
    return scores


def _value(cell: str) -> object:
    """A cell of `variants.csv`: a number, a list or nothing."""
    return json.loads(cell) if cell else None


def _read_csv(path: Path, columns: Iterable[str]) -> list[dict[str, str]]:
    """Rows of a table that has these columns."""
    with path.open(newline="") as file:
        table = csv.DictReader(file)
        missing = [name for name in columns if name not in (table.fieldnames or ())]
        rows = list(table)
    if missing:
        raise InputError.of_path(path, "a table", f"one with the columns {', '.join(missing)}")
    if any(None in row or None in row.values() for row in rows):
        raise InputError.of_path(path, "a row that is cut off or too long", "a cell for each column")
    return rows


def _read_json(path: Path) -> dict[str, Any]:
    """Nothing where there is no file.

    Raises:
        InputError: where the file holds something else than a JSON object of a few levels.
    """
    if not path.is_file():
        return {}
    with _reading(path, "a JSON object"):
        content = json.loads(path.read_text())
        if not isinstance(content, dict):
            raise InputError.of_path(path, f"a {type(content).__name__}", "a JSON object")
        _check_plain(content)
    return content


def _check_plain(content: object) -> None:
    """Raise an error where values are nested so deeply that nobody can use them, or text is none."""
    if _is_deeper(content, DEEPEST):
        raise ValueError(f"more than {DEEPEST} levels")
    json.dumps(content, ensure_ascii=False).encode()


def _is_deeper(value: object, levels: int) -> bool:
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels < 0 or any(_is_deeper(part, levels - 1) for part in parts)


@contextmanager
def _reading(path: Path, expected: str) -> Iterator[None]:
    """Whatever goes wrong in the block is the fault of this file, whose content may be anything."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        found = f"{type(error).__name__}: {error}".splitlines()[0]
        raise InputError.of_path(path, found, expected) from error
