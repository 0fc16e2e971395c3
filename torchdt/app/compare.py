"""How well trackers do on a suite of scenarios, all on the same recordings and in the same field."""

import dataclasses
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from torchdt.app.claims import run_directory
from torchdt.app.outcomes import load_outcomes, save_outcomes
from torchdt.app.report.compare_tables import (
    Comparison,
    print_comparison,
    write_comparison,
    write_events,
)
from torchdt.app.report.console import plain_console
from torchdt.app.report.files import manifest, write_json
from torchdt.app.report.scores import Quality
from torchdt.app.stage import Stage, assess, set_stage, write_outcomes
from torchdt.app.suite import SuiteSettings, compose_track, confidence
from torchdt.core.errors import StorageError, one_line
from torchdt.core.ranges import Count, Seed

log = logging.getLogger(__name__)


@dataclass
class CompareSettings(SuiteSettings):
    """Settings of `experiments/compare.py`.

    Attributes:
        trackers: options of the group `tracker`; all are compared with the first.
        runs: of each scenario, tracked in one batch.
        seed: of the first run; run b has `seed + b`.
    """

    trackers: list[str] = dataclasses.field(default_factory=list)
    runs: Count = 10
    seed: Seed = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_distinct("trackers")


ConfigStore.instance().store(name="compare_schema", node=CompareSettings)


def run_compare(config: DictConfig) -> list[Comparison]:
    """Track and score every scenario with every tracker, see `run_suite`; the table is `compare.csv`.

    Returns:
        One row per scenario and tracker. What fails leaves its error in its row, and the others go on.

    Raises:
        InputError, StorageError: see `run_suite`.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, CompareSettings)
    trackers = {name: [f"tracker={name}"] for name in settings.trackers}
    seeds = range(settings.seed, settings.seed + settings.runs)
    rows = run_suite(settings, trackers, seeds, write_comparison)
    print_comparison(plain_console(), rows)
    return rows


def run_suite(
    settings: SuiteSettings,
    trackers: Mapping[str, Sequence[str]],
    seeds: Sequence[int],
    write: Callable[[Path, Sequence[Comparison]], None],
) -> list[Comparison]:
    """Track and score every scenario with every tracker, in Hydra's run directory.

    The table grows by a row for each; `<scenario>/` holds `gospa.csv`, `figures/` and
    `tensorboard/<tracker>/`. In the directory of an interrupted run it goes on: rows that are done are not
    computed again, the interrupted one starts anew, and those that failed are tried again.

    Args:
        settings: of the job.
        trackers: overrides that choose each, by name; all are compared with the first.
        seeds: of the runs, tracked in one batch.
        write: replaces the table in a directory.

    Returns:
        One row per scenario and tracker. What fails leaves its error in its row, and the others go on.

    Raises:
        InputError: where the configuration of the suite does not make sense, or the directory holds another
            run, whose results then stay as they are.
        StorageError: where something cannot be written; the same command goes on when it can be.
    """
    directory = run_directory()
    plain = dataclasses.asdict(settings)
    fingerprint = {key: value for key, value in plain.items() if key != "tensorboard"}
    known = load_outcomes(directory / "checkpoint.pt", fingerprint)
    done = {name: rows for name, rows in known.items() if (directory / name / "gospa.csv").is_file()}
    for name in known.keys() - done.keys():
        log.warning("%s was done, but %s is gone: running again", name, directory / name / "gospa.csv")
    if done:
        log.info("going on, %d rows were done", sum(map(len, done.values())))
    write_json(directory / "manifest.json", manifest(plain, seeds[0]))
    rows: list[Comparison] = []
    for scenario in settings.suite:
        stage: Stage | None = None
        outcomes = done.setdefault(scenario, {})
        for name, choice in trackers.items():
            row = Comparison(scenario, tracker=name)
            try:
                if name not in outcomes:
                    overrides = [*choice, *settings.overrides]
                    track_settings = compose_track(scenario, overrides, seeds[0], len(seeds))
                    stage = stage or set_stage(track_settings, settings, seeds, shared=len(trackers) > 1)
                    outcome = assess(scenario, stage, track_settings, settings)
                    if settings.tensorboard:
                        events = directory / scenario / "tensorboard" / name
                        write_events(events, name, outcome.quality, outcome.gospa, seeds[0])
                    found = {**outcomes, name: outcome}
                    ordered = {tracker: found[tracker] for tracker in trackers if tracker in found}
                    write_outcomes(directory / scenario, stage, ordered)
                    outcomes[name] = outcome
                    save_outcomes(directory / "checkpoint.pt", fingerprint, done)
                quality, first = outcomes[name].quality, outcomes.get(next(iter(trackers)))
                row = beside(name, quality, first and first.quality)
                log.info("%s, %s: GOSPA %.2f in %.1f s", scenario, name, row.gospa, row.seconds)
            except StorageError:
                raise
            except Exception as error:
                log.exception("%s, %s failed", scenario, name)
                row = dataclasses.replace(row, error=one_line(error))
            rows.append(row)
            write(directory, rows)
    log.info("results in %s", directory)
    return rows


def beside(tracker: str, quality: Quality, first: Quality | None) -> Comparison:
    """Scores of a tracker beside those of the first one; None where that one failed."""
    row = Comparison(**vars(quality), tracker=tracker)
    if first is None:
        return row
    pairs = torch.tensor([quality.gospa_by_run, first.gospa_by_run], dtype=torch.float64)
    difference = pairs[0] - pairs[1]
    return dataclasses.replace(
        row,
        ahead=1 - first.gospa / quality.gospa if quality.gospa else math.nan,
        difference=float(difference.mean()),
        difference_ci=confidence(difference),
    )
