"""How time grows with the size of the problem."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from statistics import linear_regression, median

import torch

from benchmarks.clock import clock_in_turn
from benchmarks.problem import random_problem
from benchmarks.report import Measured
from torchdt.data.recording import Recording, validate
from torchdt.filter.bp.update import update
from torchdt.filter.direct import DirectTracker
from torchdt.run.track import track

POWER_POINTS, NOISE_POINTS = 16, 64
"""Support points of each power and noise variance."""


def measure_update_scaling(
    base: Mapping[str, int], sizes: Mapping[str, Sequence[int]], repeats: int, device: str
) -> list[Measured]:
    """Time of the BP update of random problems that differ from a base in one size.

    Args:
        base: `slots`, `particles`, `tones`, `sensors`, `snapshots`, `batch` and `sweeps`.
        sizes: rising, by the key of the base that they replace.
        repeats: of every update, after one that warms up; medians count.
        device: of the tensors.
    """
    rows: list[Measured] = []
    for axis, values in sizes.items():
        taken = [time_update({**base, axis: size}, repeats, device) for size in values]
        others = ", ".join(f"{value} {key}" for key, value in base.items() if key != axis)
        rows += scaling_rows(axis, values, taken, f"update; {others}")
    return rows


def time_update(problem: Mapping[str, int], repeats: int, device: str) -> float:
    """Median seconds of an update of a random problem."""
    made = random_problem(
        (problem["batch"],),
        problem["slots"],
        problem["particles"],
        problem["tones"],
        problem["sensors"],
        problem["snapshots"],
        POWER_POINTS,
        NOISE_POINTS,
        torch.float32,
        device,
        seed=0,
    )
    run = torch.inference_mode()(partial(update, *made, sweeps=problem["sweeps"]))
    return median(clock_in_turn({"update": run}, repeats, device)["update"])


def measure_length_scaling(
    tracker: DirectTracker, recording: Recording, lengths: Sequence[int], repeats: int
) -> list[Measured]:
    """Time of tracking the first steps of one sequence.

    Args:
        tracker: the tracker.
        recording: of as many steps as the longest; its first sequence is tracked.
        lengths: numbers of steps, rising.
        repeats: of all lengths in turn; medians count.
    """
    short = {k: validate(snapshots=recording.data[:1, :k], step_s=recording.step_s) for k in lengths}
    calls = {str(k): partial(track, part, tracker, [0]) for k, part in short.items()}
    taken = clock_in_turn(calls, repeats, tracker.region.low.device)
    note = f"tracking, {tracker.config.slots} slots, {tracker.config.particles} particles"
    return scaling_rows("steps", lengths, [median(taken[str(k)]) for k in lengths], note)


def scaling_rows(axis: str, sizes: Sequence[int], seconds: Sequence[float], note: str) -> list[Measured]:
    """A row for every size, `AXIS = SIZE`, and one for the exponent."""
    points = [(f"{axis} = {n}", 1e3 * t, "ms", note) for n, t in zip(sizes, seconds, strict=True)]
    upper = len(sizes) // 2
    fitted = f"least squares of log time over log size, from {sizes[upper]}: constant costs rule below"
    exponent = fit_exponent(sizes[upper:], seconds[upper:])
    return [Measured("scaling", *row) for row in (*points, (f"exponent of {axis}", exponent, "", fitted))]


def fit_exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float:
    """Slope of log time over log size, by least squares."""
    return linear_regression([math.log(n) for n in sizes], [math.log(t) for t in seconds]).slope
