"""A suite of scenarios: its settings, and the scores of a tracker in one of them."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from hydra import compose
from scipy.stats import t as student
from torch import Tensor

from torchdt.app.report.scores import Quality
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings, settings_of
from torchdt.core.errors import require
from torchdt.core.ranges import Checked, Name, NotNegative, Positive, StepIndex
from torchdt.core.trees import tree_map
from torchdt.data.recording import Recording
from torchdt.filter.history import TrackHistory
from torchdt.metrics import tgospa, track_delays, trajectories
from torchdt.simulation.visibility import hidden_steps


@dataclass
class SuiteSettings(Checked):
    """A suite of scenarios, and how they are scored.

    Attributes:
        name: of the configuration under test, for the run directory.
        suite: names of scenarios.
        overrides: of the configuration of `experiments/track.py`, in every scenario.
        separation: distance below which two sources hide each other, in the unit of the scenario's distance.
        switch_cost: gamma of T-GOSPA, as a share of the scenario's cutoff.
        surface_step: step whose estimates are drawn over the ambiguity surface; the last one of shorter
            scenarios.
        tensorboard: write event files.
    """

    name: Name = "default"
    suite: list[str] = dataclasses.field(default_factory=list)
    overrides: list[str] = dataclasses.field(default_factory=list)
    separation: NotNegative = 30.0
    switch_cost: Positive = 0.1
    surface_step: StepIndex = 200
    tensorboard: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_distinct("suite")

    def _require_distinct(self, key: str) -> None:
        values = getattr(self, key)
        require(len(set(values)) == len(values) > 0, key, values, "at least one, each once")


def compose_track(scenario: str, overrides: Sequence[str], seed: int, runs: int) -> TrackSettings:
    """Settings of `experiments/track.py` for one entry of a suite.

    Raises:
        InputError: where they do not make sense, or hold variants: a suite has a row for one setting.
    """
    choices = [f"scenario={scenario}", *overrides, f"seed={seed}", f"runs={runs}"]
    settings = settings_of(compose("track", overrides=choices))
    require(settings.variants is None, "variants", settings.variants, "null in a suite")
    return settings


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
    visible = tree_map(lambda part: part[:, ~hidden], result)
    by_run = visible.total.mean(-1)
    gamma = settings.switch_cost * scenario.gospa_cutoff
    cutoff, order, distance = scenario.gospa_cutoff, scenario.gospa_order, scenario.distance
    runs = [history.select(b) for b in range(len(truth))]
    switches = [
        tgospa(truth[b], trajectories(run), cutoff, gamma, order, distance).num_switches
        for b, run in enumerate(runs)
    ]
    delays = [track_delays(run, truth[b], cutoff, order, distance) for b, run in enumerate(runs)]
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
