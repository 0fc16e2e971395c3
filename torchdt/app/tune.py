"""Tune hyperparameters on the likelihood of simulated or recorded sequences."""

import contextlib
import dataclasses
import logging
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from torch import Tensor

from torchdt.app.claims import run_directory
from torchdt.app.progress import tune_progress
from torchdt.app.report.files import manifest, write_figures, write_json
from torchdt.app.report.hparams import row_settings
from torchdt.app.report.tuning import (
    TuningReport,
    slice_figure,
    tuning_summary,
    write_tuned,
    write_tuning_csv,
)
from torchdt.app.resume import fingerprint_of
from torchdt.app.score import score_history
from torchdt.app.settings import settings_of
from torchdt.app.tunable import SequenceSet, build_problem, gather
from torchdt.app.tune_settings import TuneSettings
from torchdt.data.prepare import prepare
from torchdt.model.hyperparameters import Hyperparameters
from torchdt.run.track import track
from torchdt.tuning.checkpoint import load_state, require_values, save_state
from torchdt.tuning.gradient import ascend
from torchdt.tuning.search import search
from torchdt.tuning.slices import slices
from torchdt.tuning.state import TuningState, numbers, raw_values, set_raw
from torchdt.tuning.tracker import TrackerFamily, TrackerObjective

log = logging.getLogger(__name__)


def run_tune(config: DictConfig) -> float | None:
    """Tune in Hydra's run directory; in that of a run that was interrupted, go on from its checkpoint.

    Tracking of the held-out set and likelihood slices are shown beside the tuning; the passes that the
    records count do not include them.

    Returns:
        Minus the best held-out log-likelihood per step, for sweeps to minimise; None if it is not finite.

    Raises:
        InputError: where configuration or data do not make sense, or the directory holds the checkpoint of
            another configuration. The directory's results then stay as they are.
        StorageError: where something cannot be written; the same command goes on when it can be.
    """
    settings = settings_of(config)
    assert isinstance(settings, TuneSettings)
    directory = run_directory()
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)
    fingerprint = fingerprint_of(settings, [*settings.train_paths, *settings.heldout_paths])
    known = load_state(directory / "checkpoint.pt", fingerprint)
    sets = [
        gather(settings, settings.train_seeds, settings.train_paths, settings.pad),
        gather(settings, settings.heldout_seeds, settings.heldout_paths, settings.pad),
    ]
    hyperparameters, families = build_problem(settings, settings.hyperparameters, sets)
    if known is not None:
        require_values(directory / "checkpoint.pt", known, raw_values(hyperparameters))
    job = TuneJob(settings, directory, fingerprint, hyperparameters, sets, families)
    if known is not None and not known.finished:
        log.info("going on after %d steps", len(known.records))
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seed))
    state = job.run(known)
    log.info("results in %s", directory)
    place = directory.resolve()
    log.info("track with the tuned values: torchdt track --config-dir=%s --config-name=tuned", place)
    return None if state.best_heldout is None else -state.best_heldout


class TuneJob:
    """One tuning run and its files.

    Args:
        settings: of the run.
        directory: for results and checkpoint.
        fingerprint: of the configuration, for the checkpoint.
        hyperparameters: at their start.
        sets: training and held-out sequences.
        families: trackers for each of them.
    """

    def __init__(
        self,
        settings: TuneSettings,
        directory: Path,
        fingerprint: dict[str, object],
        hyperparameters: Hyperparameters,
        sets: list[SequenceSet],
        families: list[TrackerFamily],
    ) -> None:
        self.settings, self.directory, self.fingerprint = settings, directory, fingerprint
        self.hyperparameters, self.sets, self.families = hyperparameters, sets, families
        self.start = raw_values(hyperparameters)
        self.train, self.heldout = (self._objective(*pair) for pair in zip(sets, families, strict=True))

    def _objective(self, sequences: SequenceSet, family: TrackerFamily) -> TrackerObjective:
        tuning = self.settings.tuning
        recording, mask, seeds = sequences
        field, count = family.field_of(self.hyperparameters()), family.model.effective_count
        prepared = prepare(recording, field, family.region, family.config, count)
        return TrackerObjective(family, prepared, mask, seeds, block=tuning.block, truncate=tuning.truncate)

    def run(self, state: TuningState | None) -> TuningState:
        """Tune from a state on, then write what was found."""
        tuning, logging_ = self.settings.tuning, self.settings.logging
        method = ascend if tuning.method == "gradient" else search
        reached = state
        with contextlib.ExitStack() as stack:
            advance = stack.enter_context(tune_progress(self.settings))
            first = 0 if state is None else len(state.records)
            report = TuningReport(self.directory / "tensorboard", first) if logging_.tensorboard else None
            if report is not None:
                stack.enter_context(report)
            for reached in method(self.hyperparameters, self.train, self.heldout, tuning, state):
                step = reached.records[-1].step
                if report is not None:
                    report.add_record(reached.records[-1])
                    if step % tuning.gospa_every == 0:
                        report.add_gospa(self.gospa(reached.best), step)
                if reached.finished or len(reached.records) % tuning.checkpoint_every == 0:
                    self.save(reached, report)
                advance(reached)
            assert reached is not None
            self.finish(reached, report)
        return reached

    def save(self, state: TuningState, report: TuningReport | None) -> None:
        """Bring the run so far to the disk, the checkpoint last: what it counts as done is there."""
        if report is not None:
            report.flush()
        write_tuning_csv(self.directory / "tuning.csv", state.records)
        save_state(self.directory / "checkpoint.pt", self.fingerprint, state)

    def gospa(self, raw: dict[str, Tensor]) -> float | None:
        """Mean GOSPA over sequences and steps of the held-out set; None without truth."""
        now = raw_values(self.hyperparameters)
        set_raw(self.hyperparameters, raw)
        sequences, family = self.sets[1], self.families[1]
        with torch.no_grad():
            history = track(sequences.recording, family.at(self.hyperparameters()), sequences.seeds)
        set_raw(self.hyperparameters, now)
        score = score_history(history, sequences.recording, self.settings)
        return None if score is None else score.total[sequences.mask].mean().item()

    def finish(self, state: TuningState, report: TuningReport | None) -> None:
        """Write the best values, what they bring, and how the likelihood falls off around them."""
        scores = self.gospa(self.start), self.gospa(state.best)
        set_raw(self.hyperparameters, state.best)
        values = self.hyperparameters.values()
        write_tuning_csv(self.directory / "tuning.csv", state.records)
        write_tuned(self.directory / "tuned.yaml", values, self.settings.statistical_model)
        write_json(
            self.directory / "tuning.json", tuning_summary(self.settings.tuning, state, values, scores)
        )
        step = state.records[-1].step
        if report is not None:
            report.add_gospa(scores[1], step)
            metrics = {"heldout": state.best_heldout, "heldout_gospa": scores[1]}
            hydra = HydraConfig.get()
            row = row_settings(
                dataclasses.asdict(self.settings), hydra.runtime.choices["tracker"], hydra.overrides.task
            )
            report.add_hparams(row | numbers(values), metrics, step)
        if self.settings.logging.figures and self.settings.tuning.slice_points:
            self._draw_slices(step, report)

    def _draw_slices(self, step: int, report: TuningReport | None) -> None:
        tuning = self.settings.tuning
        for line in slices(self.hyperparameters, self.train, tuning.width, tuning.slice_points):
            figure = slice_figure(line)
            write_figures(self.directory / "figures", {f"slice_{line.name}": figure})
            if report is not None:
                report.add_figure(f"slices/{line.name}", figure, step)
