"""The files of a run directory: `gospa.csv`, `tracks.csv`, `metrics.json`, `manifest.json`."""

import json
import math
import os
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch
from matplotlib.figure import Figure
from torch import Tensor

import torchdt
from torchdt.app.report.csv_file import write_csv
from torchdt.app.report.energy import energy_rows, hints, mean_shares
from torchdt.core.atomic import atomic_write, storing
from torchdt.filter.history import TrackHistory
from torchdt.filter.shares import PARTS
from torchdt.metrics import Gospa
from torchdt.model.model import Model

WAVEGUIDE_COLUMNS = ("range_m", "depth_m", "range_rate_mps", "depth_rate_mps")

PACKAGES = ("torchdt", "torch", "numpy", "scipy", "hydra-core", "tensorboard", "matplotlib", "rich")


def write_gospa_csv(path: str | os.PathLike[str], gospa: Gospa, times: Tensor) -> None:
    """Write one row per run and step, both counted from zero.

    Args:
        path: where to write, usually `gospa.csv`.
        gospa: `(B, K)`.
        times: `(B, K)` of the steps, s, see `Recording.times`.
    """
    header = (
        "run",
        "step",
        "time_s",
        "gospa",
        "localisation",
        "missed",
        "false",
        "num_truth",
        "num_estimated",
    )
    columns = [seconds(times), *(field.tolist() for field in gospa)]
    num_runs, num_steps = gospa.total.shape
    rows = (
        (run, step, *(column[run][step] for column in columns))
        for run in range(num_runs)
        for step in range(num_steps)
    )
    _write_csv(path, header, rows)


def write_tracks_csv(
    path: str | os.PathLike[str],
    history: TrackHistory,
    times: Tensor,
    coordinates: Sequence[str] = WAVEGUIDE_COLUMNS,
) -> None:
    """Write one row per declared object, sorted by run, step and slot.

    Args:
        path: where to write, usually `tracks.csv`.
        history: batch shape `(B,)`.
        times: `(B, K)` of the steps, s, see `Recording.times`.
        coordinates: column names of the D state entries, units included.

    Raises:
        ValueError: not one name for each state entry.
    """
    if len(coordinates) != history.state.shape[-1]:
        raise ValueError(f"coordinates: found {len(coordinates)}, expected {history.state.shape[-1]} names")
    powers = [f"power_{tone}" for tone in range(1, history.power.shape[-1] + 1)]
    deviations = [f"std_{coordinate}" for coordinate in coordinates]
    header = (
        "run",
        "step",
        "time_s",
        "label",
        "existence",
        *coordinates,
        *powers,
        *deviations,
        "transmission",
    )

    index = history.declared.nonzero(as_tuple=True)
    run, step = (axis.tolist() for axis in index[:2])
    label, existence = history.label[index].tolist(), history.existence[index].tolist()
    parts = history.state, history.power, history.state_std, history.transmission[..., None]
    values = torch.cat([part[index].double() for part in parts], -1).T.tolist()
    time = seconds(times)
    rows = ((b, k, time[b][k], *row) for b, k, *row in zip(run, step, label, existence, *values, strict=True))
    _write_csv(path, header, rows)


def seconds(times: Tensor) -> list[list[str]]:
    """Times `(B, K)` as they are written: all digits, since seconds may count from long ago."""
    return [[f"{time:.15g}" for time in row] for row in times.tolist()]


def write_variants_csv(
    path: str | os.PathLike[str],
    variants: Sequence[Model],
    history: TrackHistory,
    gospa: Gospa | None,
) -> None:
    """Write one row per setting of the model: its values, and means over its runs and all steps.

    Args:
        path: where to write, usually `variants.csv`.
        variants: V of them. A driving variance of None, the scenario's own, is an empty cell; otherwise it
            is a list in one.
        history: batch shape `(V * B,)`, variant by variant.
        gospa: `(V * B, K)`, or None without truth: its cells are empty.
    """
    names, parts = tuple(variants[0].all_quantities()), ("total", "localisation", "missed", "false")
    header = ("variant", *names, "gospa", *parts[1:], "log_likelihood")

    def means(values: Tensor) -> list[float]:
        return values.double().reshape(len(variants), -1).mean(-1).tolist()

    scores = [[None] * len(variants) if gospa is None else means(getattr(gospa, part)) for part in parts]
    columns = zip(*scores, means(history.log_evidence.double().sum(-1)), strict=True)
    rows = (
        (index, *(variant.known().get(name) for name in names), *row)
        for index, (variant, row) in enumerate(zip(variants, columns, strict=True))
    )
    _write_csv(path, header, rows)


def write_energy_csv(path: str | os.PathLike[str], history: TrackHistory, times: Tensor) -> None:
    """Write one row per run, step and tone: the noise level, and shares of the energy.

    Args:
        path: where to write, usually `energy.csv`.
        history: batch shape `(B,)`.
        times: `(B, K)` of the steps, s, see `Recording.times`.
    """
    header = ("run", "step", "time_s", "tone", "noise_level", *PARTS)
    _write_csv(path, header, energy_rows(history.shares, history.noise, seconds(times)))


def metrics_summary(
    tracker: str, history: TrackHistory, gospa: Gospa | None, seed: int, seconds: float
) -> dict[str, object]:
    """Content of `metrics.json`.

    Args:
        tracker: name of the tracker, as chosen in the configuration.
        history: batch shape `(B,)`.
        gospa: `(B, K)`, or None without truth.
        seed: of the run.
        seconds: wall-clock time of the tracking alone.

    Returns:
        `num_steps` is K and `num_runs` B; `failed_steps` of all runs broke down and count as missing;
        `steps_per_second` counts the steps of all runs; `log_likelihood` is the sum over the steps,
        averaged over the runs, and NaN, in JSON null, where the tracker does not know it; `energy` holds
        shares of the energy, see `torchdt.filter.shares`, or is None; `hints` says what may be wrong; `gospa`
        holds averages over runs and steps, or is None.
    """
    num_runs, num_steps = history.log_evidence.shape
    return {
        "tracker": tracker,
        "num_steps": num_steps,
        "num_runs": num_runs,
        "seed": seed,
        "log_likelihood": history.log_evidence.double().sum(-1).mean().item(),
        "failed_steps": int(history.failed.sum()),
        "energy": mean_shares(history),
        "hints": hints(history),
        "seconds": seconds,
        "steps_per_second": num_runs * num_steps / seconds if seconds > 0 else None,
        "gospa": None
        if gospa is None
        else {
            "mean": gospa.total.mean().item(),
            "localisation": gospa.localisation.mean().item(),
            "missed": gospa.missed.mean().item(),
            "false": gospa.false.mean().item(),
        },
    }


def manifest(config: Mapping[str, object], seed: int) -> dict[str, object]:
    """Content of `manifest.json`: what is needed to repeat a run.

    Args:
        config: the resolved configuration, of plain containers and values.
        seed: of the run.

    Returns:
        `config`, `seed`, `versions` (None for a package that is not installed) and `git_commit` (None where
        the code does not lie in a git checkout of its own).
    """
    return {
        "config": config,
        "seed": seed,
        "versions": {name: _version(name) for name in PACKAGES},
        "git_commit": _git_commit(Path(torchdt.__file__).parents[1]),
    }


def write_json(path: str | os.PathLike[str], content: Mapping[str, object]) -> None:
    """Write strict JSON: numbers that are not finite become null, unknown types their text."""
    text = json.dumps(_finite(content), indent=2, allow_nan=False, default=str)
    with atomic_write(path) as file:
        file.write(f"{text}\n".encode())


def write_figures(directory: Path, figures: Mapping[str, Figure]) -> None:
    """Write `<name>.png` for each of them, into a folder that is made if absent."""
    with storing(directory):
        directory.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        with atomic_write(directory / f"{name}.png") as file:
            figure.savefig(file, format="png", dpi=150)


def _write_csv(path: str | os.PathLike[str], header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    # Nine digits give a single-precision number back exactly.
    write_csv(path, header, ([f"{v:.9g}" if isinstance(v, float) else v for v in row] for row in rows))


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _git_commit(root: Path) -> str | None:
    # An installed copy may lie inside the checkout of some other project, whose commit would mislead.
    if not (root / ".git").exists():
        return None
    try:
        command = ["git", "-C", str(root), "rev-parse", "HEAD"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
