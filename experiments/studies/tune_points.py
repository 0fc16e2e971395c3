"""Search of the settings of a two-step tracker that reach the lowest GOSPA on a suite of scenarios.

Points are detected once, with the lowest threshold that is searched; every evaluation only tracks them.
"""

import dataclasses
import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from torchdt.app.build import build_tracker, build_tracking_field, simulate
from torchdt.app.claims import run_directory
from torchdt.app.report.csv_file import write_table
from torchdt.app.report.files import manifest, write_json
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings
from torchdt.app.suite import compose_track
from torchdt.baselines.detect.points import Points
from torchdt.baselines.mot.likelihood import GaussianPosition
from torchdt.baselines.mot.tracker import PointTracker
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.atomic import atomic_write
from torchdt.core.errors import InputError, require
from torchdt.core.random import RandomStreams
from torchdt.core.ranges import Checked, Count, Name, Seed
from torchdt.data.recording import Recording
from torchdt.filter.history import TrackHistory
from torchdt.model.measurement import Measurement
from torchdt.model.region import Region
from torchdt.run.track import derive_seed
from torchdt.tuning.config import Step
from torchdt.tuning.search import tpe

log = logging.getLogger(__name__)
STEPS_AT_ONCE = 16

FINER = 3.0
"""The threshold is searched over a range of this part of the others' width."""


@dataclass
class TunePointsSettings(Checked):
    """Settings of `experiments/tune_points.py`.

    Attributes:
        name: of the search, for the run directory.
        method: the tracker that is tuned, an option of the group `tracker`.
        suite: names of scenarios.
        runs: of each scenario.
        seed: of the first run, and of the search.
        overrides: of the configuration of `experiments/track.py`, in every scenario.
        evaluations: settings that are tried; the first are those configured.
        width: half the range that is searched, in logarithms (of the odds, for a probability) around those.
    """

    name: Name = "default"
    method: str = "mp_bp"
    suite: list[str] = dataclasses.field(default_factory=list)
    runs: Count = 1
    seed: Seed = 1000
    overrides: list[str] = dataclasses.field(default_factory=list)
    evaluations: Count = 100
    width: Step = 2.3

    def __post_init__(self) -> None:
        super().__post_init__()
        distinct = len(set(self.suite)) == len(self.suite) > 0
        require(distinct, "suite", self.suite, "at least one, each once")


ConfigStore.instance().store(name="tune_points_schema", node=TunePointsSettings)


class Detected(NamedTuple):
    """Points of one scenario.

    Attributes:
        points: batch `(B, K)`.
        recording: in which they were found.
        region: of interest.
        settings: with those of the tracker under which they were found.
    """

    points: Points
    recording: Recording
    region: Region
    settings: TrackSettings


def run_tune_points(config: DictConfig) -> float:
    """Search, in Hydra's run directory: `search.csv` grows, `tuned.yaml` holds the best settings so far.

    Returns:
        The lowest mean GOSPA over scenarios, runs and steps.

    Raises:
        InputError: where the tracker is no two-step tracker, the scenarios differ in steps or coordinates, or
            Optuna is not installed.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, TunePointsSettings)
    directory = run_directory()
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seed))
    found = [detect(scenario, settings) for scenario in settings.suite]
    kinds = {(f.points.noise.shape[1:], f.points.position.shape[1:], f.region.coordinates) for f in found}
    different = f"{len(kinds)} kinds of steps, tones and coordinates"
    require(len(kinds) == 1, "suite", different, "scenarios that can be tracked in one batch")
    configured, region = two_step(found[0].settings), found[0].region
    start = encode(configured, region)
    proposals = tpe(start, settings.width, settings.seed)
    rows: list[dict[str, object]] = []
    best, point = math.inf, next(proposals)
    for number in range(settings.evaluations):
        tried = decode(point, configured, region)
        scores = evaluate(found, tried, settings)
        mean = sum(scores) / len(scores)
        by_scenario = dict(zip(settings.suite, scores, strict=True))
        rows.append({"evaluation": number, "gospa": mean, **columns(tried), **by_scenario})
        write_table(directory / "search.csv", rows)
        if mean < best:
            best = mean
            log.info("evaluation %d: GOSPA %.3f with %s", number, mean, columns(tried))
            tuned = OmegaConf.create()
            for key, setting in columns(tried).items():
                OmegaConf.update(tuned, key, setting)
            with atomic_write(directory / "tuned.yaml") as file:
                file.write(OmegaConf.to_yaml(tuned).encode())
        point = proposals.send(-mean)
    log.info("results in %s", directory)
    return best


def detect(scenario: str, settings: TunePointsSettings) -> Detected:
    """Simulate a scenario and detect points in all of its steps, down to the lowest threshold searched."""
    track_settings = compose_track(
        scenario, [f"tracker={settings.method}", *settings.overrides], settings.seed, settings.runs
    )
    config = two_step(track_settings)
    lowest = config.detector.threshold * math.exp(-settings.width / FINER)
    config = replace(config, detector=replace(config.detector, threshold=lowest))
    recording = simulate(track_settings)
    field = build_tracking_field(track_settings, recording)
    tracker = build_tracker(replace(track_settings, tracker=config), recording, field)
    assert isinstance(tracker, TwoStepTracker)
    measurement = tracker.prepare(recording).measurement
    parts = []
    for first in range(0, recording.num_steps, STEPS_AT_ONCE):
        steps = slice(first, first + STEPS_AT_ONCE)
        parts.append(tracker.detector(Measurement(*(t[:, steps] for t in measurement))))
    points = Points(*(torch.cat(part, 1) for part in zip(*parts, strict=True)))
    log.info("%s: %.2f points per step", scenario, points.present.sum(-1).double().mean())
    return Detected(points, recording, tracker.region, track_settings)


def two_step(settings: TrackSettings) -> TwoStepConfig:
    """Settings of a two-step tracker.

    Raises:
        InputError: where they are those of another one.
    """
    config = settings.built_tracker
    if not isinstance(config, TwoStepConfig):
        raise InputError.of_key("method", type(config).__name__, "a two-step tracker")
    return config


def encode(config: TwoStepConfig, region: Region) -> Tensor:
    """Unconstrained values of what is searched, `(4 + d,)` float64."""
    probability = config.detection_probability
    spread = config.spread_in(region)
    values = (
        math.log(probability / (1 - probability)),
        math.log(config.clutter_mean),
        math.log(config.birth_mean),
        FINER * math.log(config.detector.threshold),
        *(math.log(s / cell) for s, cell in zip(spread, region.cell.tolist(), strict=True)),
    )
    return torch.tensor(values, dtype=torch.float64)


def decode(point: Tensor, config: TwoStepConfig, region: Region) -> TwoStepConfig:
    """Settings from unconstrained values; what is not searched is that of `config`."""
    odds, clutter_mean, birth_mean, cubed, *spread = point.exp().tolist()
    return replace(
        config,
        detection_probability=odds / (1 + odds),
        clutter_mean=clutter_mean,
        birth_mean=birth_mean,
        spread={c.name: cells for c, cells in zip(region.coordinates, spread, strict=True)},
        detector=replace(config.detector, threshold=cubed ** (1 / FINER)),
    )


def columns(config: TwoStepConfig) -> dict[str, float]:
    """What is searched, by the names of the configuration."""
    names = ("detection_probability", "clutter_mean", "birth_mean")
    spread = {f"spread.{name}": cells for name, cells in config.spread.items()}
    threshold = {"detector.threshold": config.detector.threshold}
    return {**{name: getattr(config, name) for name in names}, **spread, **threshold}


def evaluate(found: Sequence[Detected], config: TwoStepConfig, settings: TunePointsSettings) -> list[float]:
    """Mean GOSPA of each scenario; all scenarios are tracked as one batch."""
    region = found[0].region
    tracker = PointTracker(
        region,
        found[0].recording.step_s,
        config,
        GaussianPosition(region, config.spread_in(region)),
    )
    points = Points(*(torch.cat(part) for part in zip(*(f.points for f in found), strict=True)))
    points = points.above(config.detector.threshold)
    num_runs, num_steps = points.noise.shape[:2]
    seeds = [derive_seed(settings.seed + run, "filter") for run in range(num_runs)]
    streams = RandomStreams.from_seeds(seeds, (num_runs,), region.low.dtype, region.low.device)
    state, steps = tracker.init((num_runs,), points.noise.shape[-1]), []
    with torch.inference_mode():
        for k in range(num_steps):
            state, estimate = tracker.step(state, Points(*(t[:, k] for t in points)), streams)
            steps.append(estimate)
    history = TrackHistory.of_steps(steps, 1)
    scores = []
    for part, own in zip(found, history_parts(history, [len(f.points.noise) for f in found]), strict=True):
        gospa = score_history(own, part.recording, part.settings)
        assert gospa is not None
        scores.append(float(gospa.total.mean()))
    return scores


def history_parts(history: TrackHistory, sizes: Sequence[int]) -> Iterator[TrackHistory]:
    """Split the leading dimension."""
    for parts in zip(*(t.split(list(sizes)) for t in history), strict=True):
        yield TrackHistory(*parts)
