"""Gradients of the likelihood: their spread over the filter's random numbers, their bias, their price."""

import dataclasses
import itertools
import logging
import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from hydra import compose
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from rich.table import Table

from torchdt.app.claims import run_directory
from torchdt.app.report.console import plain_console
from torchdt.app.report.csv_file import write_csv
from torchdt.app.report.files import manifest, write_json
from torchdt.app.settings import settings_of
from torchdt.app.tunable import build_problem, gather
from torchdt.app.tune_settings import TuneSettings
from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Range, Steps
from torchdt.data.prepare import prepare
from torchdt.tuning.objective import evaluate
from torchdt.tuning.tracker import TrackerObjective

log = logging.getLogger(__name__)
GRADIENTS = ("score", "reparameterised")
COLUMNS = ("gradient", "truncate", "hyperparameter", "mean", "std", "standard_error", "seconds")


@dataclass
class GradientsSettings(Checked):
    """Settings of `experiments/gradients.py`.

    Attributes:
        overrides: of the configuration of `experiments/tune.py`, whose start is where gradients are taken.
        repeats: runs of the filter with other random numbers, on the same training sequences.
        gradients: estimators to compare, of the group `tracker/gradient`.
        truncations: steps after which the gradient through the state is cut; null never cuts it.
    """

    overrides: list[str] = dataclasses.field(default_factory=list)
    repeats: Annotated[int, Range("two or more", low=2, most=1e4, whole=True)] = 8
    gradients: list[str] = dataclasses.field(default_factory=lambda: list(GRADIENTS))
    truncations: list[Steps | None] = dataclasses.field(default_factory=lambda: [None])

    def __post_init__(self) -> None:
        super().__post_init__()
        known = all(gradient in GRADIENTS for gradient in self.gradients)
        require(known, "gradients", self.gradients, f"some of {GRADIENTS}")


ConfigStore.instance().store(name="gradients_schema", node=GradientsSettings)


def run_gradients(config: DictConfig) -> list[tuple]:
    """Compare gradient estimators; `gradients.csv` and `manifest.json` in Hydra's run directory.

    Returns:
        Rows of `gradients.csv`: derivatives of the log-likelihood per time step in the unconstrained values,
        their mean, standard deviation and standard error over the repeats; median seconds of a gradient.

    Raises:
        InputError: where the configuration does not make sense.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, GradientsSettings)
    directory = run_directory()
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), 0))
    rows: list[tuple] = []
    for gradient, truncate in itertools.product(settings.gradients, settings.truncations):
        overrides = [*settings.overrides, f"tracker/gradient={gradient}"]
        tune = settings_of(compose("tune", overrides=overrides))
        assert isinstance(tune, TuneSettings)
        found, seconds = differentiate(tune, truncate, settings.repeats)
        for name, values in found.items():
            spread = float(np.std(values, ddof=1))
            error = spread / len(values) ** 0.5
            rows.append((gradient, truncate, name, float(np.mean(values)), spread, error, seconds))
        log.info("%s, truncate %s: %.1f s a gradient", gradient, truncate, seconds)
        write_csv(directory / "gradients.csv", COLUMNS, rows)
    _print(rows)
    log.info("results in %s", directory)
    return rows


def differentiate(
    settings: TuneSettings, truncate: int | None, repeats: int
) -> tuple[dict[str, list[float]], float]:
    """Derivatives at the start by hyperparameter, one for each repeat, and the median of their seconds."""
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    train = gather(settings, settings.train_seeds, settings.train_paths, settings.pad)
    hyperparameters, (family,) = build_problem(settings, settings.hyperparameters, [train])
    field = family.field_of(hyperparameters())
    prepared = prepare(train.recording, field, family.region, family.config)
    found: dict[str, list[float]] = {}
    seconds = []
    for repeat in range(repeats):
        seeds = [seed + 10_000 * repeat for seed in train.seeds]
        objective = TrackerObjective(
            family, prepared, train.mask, seeds, block=settings.tuning.block, truncate=truncate
        )
        hyperparameters.zero_grad()
        start = time.perf_counter()
        evaluate(objective, hyperparameters, prior=False).backward()
        seconds.append(time.perf_counter() - start)
        for name, value in hyperparameters.named_parameters():
            # Nothing depends on a number of which no use was made.
            grad = torch.zeros_like(value) if value.grad is None else value.grad
            for index, entry in enumerate(grad.flatten().tolist(), start=1):
                key = name if value.numel() == 1 else f"{name}_{index}"
                found.setdefault(key, []).append(entry)
    return found, float(np.median(seconds))


def _print(rows: list[tuple]) -> None:
    table = Table(title="Derivatives of the log-likelihood per step")
    for column in COLUMNS:
        table.add_column(column.replace("_", " "))
    for row in rows:
        table.add_row(*(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row))
    plain_console().print(table)
