"""How well the tracker does on a suite of scenarios, each with several seeds."""

import csv
import dataclasses
import io
import itertools
import logging
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from hydra import compose
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table
from scipy.optimize import linear_sum_assignment
from scipy.stats import t as student
from torch import Tensor

from torchdt.atomic import atomic_write
from torchdt.errors import require
from torchdt.experiment.build import build_tracker, simulate
from torchdt.experiment.settings import TrackSettings, settings_of
from torchdt.experiment.track import score_history
from torchdt.history import TrackHistory
from torchdt.metrics.gospa import Gospa
from torchdt.metrics.tgospa import tgospa, trajectories
from torchdt.report.files import manifest, write_json
from torchdt.scenario.recording import Recording
from torchdt.scenario.settings import ScenarioSettings
from torchdt.scenario.visibility import hidden_steps
from torchdt.tracking import track

log = logging.getLogger(__name__)


@dataclass
class QualitySettings:
    """Settings of `experiments/quality.py`.

    Attributes:
        name: of the configuration under test, for the run directory.
        suite: names of scenarios.
        seeds: of the runs; consecutive ones are tracked in one batch.
        overrides: of the configuration of `experiments/track.py`, in every scenario.
        separation: distance below which two sources hide each other, in the coordinates' unit.
        switch_cost: gamma of T-GOSPA, as a share of the scenario's cutoff.
    """

    name: str = "default"
    suite: list[str] = dataclasses.field(default_factory=list)
    seeds: list[int] = dataclasses.field(default_factory=lambda: [0])
    overrides: list[str] = dataclasses.field(default_factory=list)
    separation: float = 30.0
    switch_cost: float = 0.1

    def __post_init__(self) -> None:
        for key in ("suite", "seeds"):
            values = getattr(self, key)
            distinct = len(set(values)) == len(values) > 0
            require(distinct, key, values, "at least one, each once")
        require(0 <= self.separation < math.inf, "separation", self.separation, "a number from 0 up")
        require(0 < self.switch_cost < math.inf, "switch_cost", self.switch_cost, "a positive number")


ConfigStore.instance().store(name="quality_schema", node=QualitySettings)


@dataclass
class Quality:
    """Scores of one scenario; means are over runs and visible steps unless it says otherwise.

    Attributes:
        scenario: its name.
        error: what went wrong; empty where nothing did.
        runs, hidden: number of runs, and of hidden steps in each.
        gospa, gospa_ci: mean GOSPA and half its 95 % confidence interval over the runs (Student's t).
        localisation, missed, false: its parts.
        gospa_all, gospa_hidden: mean GOSPA over all steps, and over the hidden ones.
        count_error: mean absolute difference of the numbers of declared and true objects.
        switches: label switches per run (T-GOSPA), all steps.
        false_per_100: false estimates per 100 steps.
        birth_delay: median steps from birth to the first assigned estimate within the cutoff; the lifetime
            for a source that is never found.
        drop_delay: median steps from death to the end of the track that had the source in its last step; the
            remaining steps for one that goes on to the end.
        steps_per_second: of all runs together, tracking alone.
        real_time: how many times faster than the recording the tracking of all runs together is.
        seconds: calibration and tracking of all runs.
        gospa_by_run: mean GOSPA of each run, for paired comparisons.
    """

    scenario: str
    error: str = ""
    runs: int = 0
    hidden: int = 0
    gospa: float = math.nan
    gospa_ci: float = math.nan
    localisation: float = math.nan
    missed: float = math.nan
    false: float = math.nan
    gospa_all: float = math.nan
    gospa_hidden: float = math.nan
    count_error: float = math.nan
    switches: float = math.nan
    false_per_100: float = math.nan
    birth_delay: float = math.nan
    drop_delay: float = math.nan
    steps_per_second: float = math.nan
    real_time: float = math.nan
    seconds: float = math.nan
    gospa_by_run: list[float] = dataclasses.field(default_factory=list)


TABLES = {
    "GOSPA": {
        "gospa": "mean",
        "gospa_ci": "± 95 %",
        "localisation": "local.",
        "missed": "missed",
        "false": "false",
        "gospa_all": "all steps",
        "gospa_hidden": "hidden",
    },
    "Tracks": {
        "count_error": "count error",
        "switches": "switches",
        "false_per_100": "false/100",
        "birth_delay": "birth delay",
        "drop_delay": "drop delay",
    },
    "Speed": {
        "runs": "runs",
        "steps_per_second": "steps/s",
        "real_time": "x real time",
        "seconds": "seconds",
    },
}


def run_quality(config: DictConfig) -> list[Quality]:
    """Track and score every scenario; `quality.csv` and `quality.json` grow in Hydra's run directory.

    Returns:
        One row per scenario. A scenario that fails leaves its error in its row, and the others go on.

    Raises:
        InputError: where the configuration of the suite does not make sense.
    """
    settings = OmegaConf.to_object(config)
    assert isinstance(settings, QualitySettings)
    directory = Path(HydraConfig.get().runtime.output_dir)
    write_json(directory / "manifest.json", manifest(dataclasses.asdict(settings), settings.seeds[0]))
    rows: list[Quality] = []
    for scenario in settings.suite:
        try:
            rows.append(assess(scenario, settings))
            log.info("%s: GOSPA %.2f in %.1f s", scenario, rows[-1].gospa, rows[-1].seconds)
        except Exception as error:
            log.exception("%s failed", scenario)
            # The log has all of it; a cell of a table takes one line.
            rows.append(Quality(scenario, error=f"{type(error).__name__}: {error}".splitlines()[0]))
        write_rows(directory, rows)
    print_rows(Console(), rows)
    log.info("results in %s", directory)
    return rows


def assess(scenario: str, settings: QualitySettings) -> Quality:
    """Simulate, track and score all runs of one scenario."""
    recordings, histories, seconds, tracking = [], [], 0.0, 0.0
    for seeds in consecutive(settings.seeds):
        batch = [f"scenario={scenario}", *settings.overrides, f"seed={seeds[0]}", f"runs={len(seeds)}"]
        track_settings = settings_of(compose("track", overrides=batch))
        if track_settings.threads is not None:
            torch.set_num_threads(track_settings.threads)
        recordings.append(simulate(track_settings))
        start = time.perf_counter()
        tracker = build_tracker(track_settings, recordings[-1])
        ready = time.perf_counter()
        histories.append(track(recordings[-1], tracker, seeds))
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


def consecutive(seeds: Sequence[int]) -> list[list[int]]:
    """Stretches of seeds that rise by one."""
    groups = itertools.groupby(enumerate(seeds), key=lambda pair: pair[1] - pair[0])
    return [[seed for _, seed in group] for _, group in groups]


def score(
    name: str,
    history: TrackHistory,
    recording: Recording,
    track_settings: TrackSettings,
    settings: QualitySettings,
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
    delays = [track_delays(run, truth[b], scenario) for b, run in enumerate(runs)]
    births, drops = ([d for pair in delays for d in pair[i]] for i in range(2))
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


def track_delays(
    history: TrackHistory, truth: Tensor, scenario: ScenarioSettings
) -> tuple[list[int], list[int]]:
    """Delays of declaring and of dropping, in steps; `Quality` says how they count.

    Args:
        history: of one run, without batch.
        truth: `(K, L, d)`, NaN while absent; a source is present in one stretch.
        scenario: gives cutoff and order of the assignment.

    Returns:
        One delay for each source that is born, and one for each that dies while it is tracked.
    """
    present = ~truth.isnan().any(-1)
    owner = torch.zeros_like(present, dtype=torch.int64)  # label of the estimate assigned, 0 = none
    reported = [history.label[k][declared] for k, declared in enumerate(history.declared)]
    for k, labels in enumerate(reported):
        distance = torch.cdist(truth[k, present[k]], history.position[k, history.declared[k]].double())
        i, j = linear_sum_assignment(distance.clamp_max(scenario.gospa_cutoff) ** scenario.gospa_order)
        near = (distance[i, j] < scenario.gospa_cutoff).numpy()
        owner[k, present[k].nonzero()[i[near], 0]] = labels[j[near]]

    births, drops = [], []
    for source in range(truth.shape[1]):
        steps = present[:, source].nonzero()[:, 0]
        if not len(steps):
            continue
        found = owner[steps, source].nonzero()[:, 0]
        births.append(int(found[0]) if len(found) else len(steps))
        end = int(steps[-1]) + 1
        label = owner[end - 1, source]
        if end < len(truth) and label > 0:
            lasts = [bool((labels == label).any()) for labels in reported[end:]]
            drops.append(lasts.index(False) if False in lasts else len(lasts))
    return births, drops


def write_rows(directory: Path, rows: Sequence[Quality]) -> None:
    """Replace `quality.csv` and `quality.json`."""
    table = [dataclasses.asdict(row) for row in rows]
    write_json(directory / "quality.json", {"scenarios": table})
    columns = [key for key, value in table[0].items() if not isinstance(value, list)]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    with atomic_write(directory / "quality.csv") as file:
        file.write(buffer.getvalue().encode())


def print_rows(console: Console, rows: Sequence[Quality]) -> None:
    """Print the tables, then what failed."""
    for title, columns in TABLES.items():
        table = Table(title=title)
        table.add_column("scenario")
        for header in columns.values():
            table.add_column(header, justify="right")
        for row in rows:
            values = (getattr(row, name) for name in columns)
            table.add_row(row.scenario, *("-" if math.isnan(v) else f"{v:.3g}" for v in values))
        console.print(table)
    for row in rows:
        if row.error:
            console.print(f"{row.scenario} failed: {row.error}", style="bold red", markup=False)
