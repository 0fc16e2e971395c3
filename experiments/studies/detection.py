"""How weak a source each tracker declares, and how fast, beside a filter that is told the track."""

import dataclasses
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from studies.declared import first_declared, first_true, num_begun, num_tracks
from studies.detection_report import BOUND, Detections, Report, print_report, write_figure, write_tables
from studies.told import told_log_odds, track_evidence
from torchdt.app.build import build_region, build_tracker, build_tracking_field, simulate
from torchdt.app.claims import run_directory
from torchdt.app.parallel import set_threads, track_in_chunks
from torchdt.app.report.console import plain_console
from torchdt.app.report.files import manifest, write_json
from torchdt.app.settings import TrackSettings
from torchdt.app.suite import compose_track
from torchdt.app.targets import build_field
from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Count, Decibels, Name, Seed, Steps
from torchdt.core.trees import tree_map
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField
from torchdt.filter.history import TrackHistory
from torchdt.simulation.settings import ScenarioSettings
from torchdt.simulation.simulate import noise_variance
from torchdt.tuning.sequences import stack_recordings

log = logging.getLogger(__name__)


@dataclass
class DetectionSettings(Checked):
    """Settings of `experiments/detection.py`.

    Attributes:
        name: of the study, for the run directory.
        scene: scenario of one source that is there in all steps.
        levels: of that source over the noise, dB per element, tone and snapshot; rising.
        trackers: options of the group `tracker`.
        runs: sequences of each level, with the same random numbers at all of them.
        noise_runs: sequences of noise alone.
        seed: of the first sequence; sequence b has `seed + b`.
        within: numbers of steps in which the source is to be declared.
        shown: that of them which table and figure show.
        overrides: of the configuration of `experiments/track.py`, with every tracker.
        tensorboard: write event files.
    """

    name: Name = "default"
    scene: str = "line_faint"
    levels: list[Decibels] = dataclasses.field(default_factory=list)
    trackers: list[str] = dataclasses.field(default_factory=list)
    runs: Count = 20
    noise_runs: Count = 40
    seed: Seed = 0
    within: list[Steps] = dataclasses.field(default_factory=lambda: [10, 30, 100])
    shown: Steps = 30
    overrides: list[str] = dataclasses.field(default_factory=list)
    tensorboard: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        rising = 0 < len(self.levels) == len(set(self.levels)) and sorted(self.levels) == self.levels
        require(rising, "levels", self.levels, "at least one, rising")
        distinct = 0 < len(self.trackers) == len(set(self.trackers))
        require(distinct, "trackers", self.trackers, "at least one, each once")
        require(self.shown in self.within, "shown", self.shown, f"one of within, {self.within}")


ConfigStore.instance().store(name="detection_schema", node=DetectionSettings)


class Sequences(NamedTuple):
    """All sequences of the study as one batch: R of each of L levels, then those of noise alone.

    Attributes:
        recording: of L R + N sequences.
        seeds: of each.
        track: `(K, d)` of the source.
        shape: L and R.
    """

    recording: Recording
    seeds: list[int]
    track: Tensor
    shape: tuple[int, int]

    @property
    def num_heard(self) -> int:
        """Sequences with the source."""
        return self.shape[0] * self.shape[1]

    @property
    def hours(self) -> float:
        """Of noise alone."""
        number = self.recording.batch_size - self.num_heard
        return number * self.recording.num_steps * self.recording.step_s / 3600


def run_detection(config: DictConfig) -> None:
    """Measure all trackers, in Hydra's run directory.

    `detection.csv` and `detection.json` grow tracker by tracker; figure and event files come at the end.

    Raises:
        InputError: where the configuration does not make sense, or the scenario is not of one source.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, DetectionSettings)
    directory = run_directory()
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seed))
    first = track_settings(settings, settings.trackers[0])
    set_threads(first)
    sequences = simulate_levels(first, settings)
    told = {BOUND: bound(sequences, first, settings)}
    found: dict[str, Detections] = {}
    for name, detections in detect(sequences, settings):
        found[name] = detections
        report = Report(settings.levels, settings.within, settings.shown, found | told)
        write_tables(directory, report)
    write_figure(directory, report, settings.tensorboard)
    print_report(plain_console(), report)
    log.info("results in %s", directory)


def track_settings(settings: DetectionSettings, tracker: str) -> TrackSettings:
    """Settings of `experiments/track.py` with one tracker.

    Raises:
        InputError: where the scenario is not of one source, or too short.
    """
    overrides = [f"tracker={tracker}", *settings.overrides]
    found = compose_track(settings.scene, overrides, settings.seed, settings.runs)
    scenario = found.scenario
    sources = list(scenario.sources.values())
    whole = len(sources) == 1 and (sources[0].birth, sources[0].death, sources[0].silences) == (0, None, [])
    known = whole and scenario.mismatch.matched
    require(known, "scene", settings.scene, "one source, there in all steps, in a field without mismatch")
    most = max(settings.within)
    require(scenario.num_steps >= most, "scenario.num_steps", scenario.num_steps, f"{most} or more")
    return found


def simulate_levels(chosen: TrackSettings, settings: DetectionSettings) -> Sequences:
    """Simulate every level, and noise alone."""
    scenarios = [at_level(chosen.scenario, level) for level in settings.levels]
    parts = [simulate(replace(chosen, scenario=scenario)) for scenario in scenarios]
    silent = replace(chosen.scenario, sources={})
    parts.append(simulate(replace(chosen, scenario=silent, runs=settings.noise_runs)))
    seeds = [settings.seed + run for part in parts for run in range(part.batch_size)]
    truth = parts[0].truth
    assert truth is not None
    return Sequences(stack_recordings(parts)[0], seeds, truth[0, :, 0], (len(settings.levels), settings.runs))


def at_level(scenario: ScenarioSettings, level: float) -> ScenarioSettings:
    """The scenario with its source at another level, dB per element, tone and snapshot."""
    sources = {n: replace(s, power_db=level - scenario.snr_db) for n, s in scenario.sources.items()}
    return replace(scenario, sources=sources)


def detect(sequences: Sequences, settings: DetectionSettings) -> Iterator[tuple[str, Detections]]:
    """Track all sequences with one tracker after the other, in the same field."""
    field = None
    for name in settings.trackers:
        chosen, start = track_settings(settings, name), time.perf_counter()
        field = field or build_tracking_field(chosen, sequences.recording)
        tracker = build_tracker(chosen, sequences.recording, field)
        history = track_in_chunks(chosen, sequences.recording, tracker, sequences.seeds)
        yield name, detections_of(tree_map(lambda part: part.cpu(), history), sequences, chosen.scenario)
        log.info("%s: %.1f s", name, time.perf_counter() - start)


def detections_of(history: TrackHistory, sequences: Sequences, scenario: ScenarioSettings) -> Detections:
    """What a tracker has declared in all sequences."""
    heard = tree_map(lambda part: part[: sequences.num_heard], history)
    noise = tree_map(lambda part: part[sequences.num_heard :], history)
    track = sequences.track.expand(sequences.num_heard, -1, -1)
    first = first_declared(heard, track, scenario.gospa_cutoff, scenario.distance)
    return Detections(first.unflatten(0, sequences.shape), num_tracks(noise), sequences.hours)


def bound(sequences: Sequences, chosen: TrackSettings, settings: DetectionSettings) -> Detections:
    """What a filter declares that is told the track, the level and the noise, on the same sequences.

    In noise alone it is told the lowest level, which fits noise best.
    """
    scenario, snapshots = chosen.scenario, sequences.recording.snapshots
    assert snapshots is not None
    field = build_field(chosen.field, torch.float64, "cpu")
    levels = torch.tensor(settings.levels, dtype=torch.float64).repeat_interleave(settings.runs)
    levels = torch.cat([levels, levels[:1].expand(settings.noise_runs)])
    power = 10 ** ((levels - scenario.snr_db) / 10)
    track = sequences.track.expand(len(snapshots), -1, -1)
    evidence = track_evidence(snapshots, field, track, power, noise_variance(field, scenario))
    model = chosen.statistical_model
    declared = told_log_odds(evidence, float(model.survival), birth_probability(chosen, field)) > 0
    heard, noise = declared.tensor_split([sequences.num_heard])
    first = first_true(heard).unflatten(0, sequences.shape)
    return Detections(first, num_begun(noise), sequences.hours)


def birth_probability(chosen: TrackSettings, field: BaseField) -> float:
    """Probability that an object is born in a step, `mu_B / (1 + mu_B)`, wherever in the region it is."""
    region = build_region(chosen, torch.float64).within(field)
    centres = region.cell_centres()[region.is_birth_cell]
    mean = chosen.statistical_model.birth.on(region).log_odds(region, centres).exp().sum()
    return float(mean / (1 + mean))
