"""How well the tracker does on a suite of scenarios, each with several seeds."""

import dataclasses
import itertools
import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from hydra import compose
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from scipy.stats import t as student
from torch import Tensor

from torchdt.app.build import build_tracker, simulate
from torchdt.app.claims import run_directory
from torchdt.app.parallel import set_threads, track_in_chunks
from torchdt.app.report.console import plain_console
from torchdt.app.report.files import manifest, write_json
from torchdt.app.report.quality import Quality, print_rows, write_rows
from torchdt.app.settings import TrackSettings, settings_of
from torchdt.app.track import score_history
from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Name, NotNegative, Positive, Seed
from torchdt.data.recording import Recording
from torchdt.filter.history import TrackHistory
from torchdt.metrics import Gospa, tgospa, track_delays, trajectories
from torchdt.simulation.visibility import hidden_steps

log = logging.getLogger(__name__)


@dataclass
class SuiteSettings(Checked):
    """A suite of scenarios, and how they are scored.

    Attributes:
        name: of the configuration under test, for the run directory.
        suite: names of scenarios.
        overrides: of the configuration of `experiments/track.py`, in every scenario.
        separation: distance below which two sources hide each other, in the coordinates' unit.
        switch_cost: gamma of T-GOSPA, as a share of the scenario's cutoff.
    """

    name: Name = "default"
    suite: list[str] = dataclasses.field(default_factory=list)
    overrides: list[str] = dataclasses.field(default_factory=list)
    separation: NotNegative = 30.0
    switch_cost: Positive = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_distinct("suite")

    def _require_distinct(self, key: str) -> None:
        values = getattr(self, key)
        require(len(set(values)) == len(values) > 0, key, values, "at least one, each once")


@dataclass
class QualitySettings(SuiteSettings):
    """Settings of `experiments/quality.py`.

    Attributes:
        seeds: of the runs; consecutive ones are tracked in one batch.
    """

    seeds: list[Seed] = dataclasses.field(default_factory=lambda: [0, 1, 2, 3, 4])

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_distinct("seeds")


ConfigStore.instance().store(name="quality_schema", node=QualitySettings)


def run_quality(config: DictConfig) -> list[Quality]:
    """Track and score every scenario; `quality.csv` and `quality.json` grow in Hydra's run directory.

    Returns:
        One row per scenario. A scenario that fails leaves its error in its row, and the others go on.

    Raises:
        InputError: where the configuration of the suite does not make sense.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, QualitySettings)
    directory = run_directory()
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seeds[0]))
    rows: list[Quality] = []
    for scenario in settings.suite:
        try:
            rows.append(assess(scenario, settings))
            log.info("%s: GOSPA %.2f in %.1f s", scenario, rows[-1].gospa, rows[-1].seconds)
        except Exception as error:
            log.exception("%s failed", scenario)
            rows.append(Quality(scenario, error=one_line(error)))
        write_rows(directory, rows)
    print_rows(plain_console(), rows)
    log.info("results in %s", directory)
    return rows


def assess(scenario: str, settings: QualitySettings) -> Quality:
    """Simulate, track and score all runs of one scenario."""
    recordings, histories, seconds, tracking = [], [], 0.0, 0.0
    for seeds in consecutive(settings.seeds):
        batch = [f"scenario={scenario}", *settings.overrides, f"seed={seeds[0]}", f"runs={len(seeds)}"]
        track_settings = compose_track(batch)
        set_threads(track_settings)
        recordings.append(simulate(track_settings))
        start = time.perf_counter()
        tracker = build_tracker(track_settings, recordings[-1])
        ready = time.perf_counter()
        histories.append(track_in_chunks(track_settings, recordings[-1], tracker, seeds))
        end = time.perf_counter()
        seconds, tracking = seconds + end - start, tracking + end - ready
    history = TrackHistory(*(torch.cat(parts).cpu() for parts in zip(*histories, strict=True)))
    truth = torch.cat([r.truth for r in recordings if r.truth is not None])
    recording = dataclasses.replace(
        recordings[0], snapshots=torch.cat([r.data for r in recordings]), truth=truth
    )
    num_steps = recording.num_steps
    return dataclasses.replace(
        score(scenario, history, recording, track_settings, settings),
        steps_per_second=len(truth) * num_steps / tracking,
        real_time=recording.step_s * num_steps / tracking,
        seconds=seconds,
    )


def compose_track(overrides: Sequence[str]) -> TrackSettings:
    """Settings of `experiments/track.py` for one entry of a suite.

    Raises:
        InputError: where they do not make sense, or hold variants: a suite has a row for one setting.
    """
    settings = settings_of(compose("track", overrides=list(overrides)))
    require(settings.variants is None, "variants", settings.variants, "null in a suite")
    return settings


def one_line(error: Exception) -> str:
    """What a cell of a table takes of an error; the log has all of it."""
    return f"{type(error).__name__}: {error}".splitlines()[0]


def consecutive(seeds: Sequence[int]) -> list[list[int]]:
    """Stretches of seeds that rise by one."""
    groups = itertools.groupby(enumerate(seeds), key=lambda pair: pair[1] - pair[0])
    return [[seed for _, seed in group] for _, group in groups]


def score(
    name: str,
    history: TrackHistory,
    recording: Recording,
    track_settings: TrackSettings,
    settings: SuiteSettings,
) -> Quality:
    """All of `Quality` that does not need a clock.

    Args:
        name: of the scenario.
        history: batch shape `(B,)`, on the CPU.
        recording: the same B sequences, simulated: all with the same truth.
        track_settings: under which they were made.
        settings: of the suite.
    """
    scenario, truth = track_settings.scenario, recording.truth
    result = score_history(history, recording, track_settings)
    assert result is not None
    assert truth is not None
    hidden = hidden_steps(scenario, truth[0], settings.separation)
    visible = Gospa(*(part[:, ~hidden] for part in result))
    by_run = visible.total.mean(-1)
    gamma = settings.switch_cost * scenario.gospa_cutoff
    cutoff, order = scenario.gospa_cutoff, scenario.gospa_order
    runs = [history.select(b) for b in range(len(truth))]
    switches = [
        tgospa(truth[b], trajectories(run), cutoff, gamma, order).num_switches for b, run in enumerate(runs)
    ]
    delays = [track_delays(run, truth[b], cutoff, order) for b, run in enumerate(runs)]
    births, drops = (list(itertools.chain(*steps)) for steps in zip(*delays, strict=True))
    error = (visible.num_estimated - visible.num_truth).abs().double().mean()
    return Quality(
        scenario=name,
        runs=len(runs),
        hidden=int(hidden.sum()),
        gospa=float(by_run.mean()),
        gospa_ci=confidence(by_run),
        localisation=float(visible.localisation.mean()),
        missed=float(visible.missed.mean()),
        false=float(visible.false.mean()),
        gospa_all=float(result.total.mean()),
        gospa_hidden=float(result.total[:, hidden].mean()),
        count_error=float(error),
        switches=float(np.mean(switches)),
        false_per_100=100 * float(visible.false.mean()) / (cutoff**order / 2),
        birth_delay=float(np.median(births)) if births else math.nan,
        drop_delay=float(np.median(drops)) if drops else math.nan,
        gospa_by_run=by_run.tolist(),
    )


def confidence(values: Tensor) -> float:
    """Half the 95 % confidence interval of the mean of `(B,)` values; NaN for a single one."""
    number = len(values)
    if number < 2:
        return math.nan
    return float(student.ppf(0.975, number - 1) * values.std() / math.sqrt(number))
