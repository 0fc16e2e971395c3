"""Scores of one tracker in one scenario."""

import dataclasses
import math
from dataclasses import dataclass


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
        birth_delay, drop_delay: medians of `TrackDelays` over the sources of all runs, steps.
        steps_per_second: of all runs together, tracking alone.
        real_time: how many times faster than the recording the tracking of all runs together is.
        seconds: tracking of all runs, and calibration of the field where no other tracker shares it.
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
