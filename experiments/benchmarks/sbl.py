"""Time and memory of sparse Bayesian learning, beside plain formulations of the same mathematics."""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median

import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.clock import clock
from benchmarks.memory import probe
from benchmarks.oracle import load_oracle
from benchmarks.report import HIGH, Measured, Plain, plain_rows
from torchdt.baselines.detect.peaks import Grid, find_peaks
from torchdt.baselines.detect.sbl import SparseBayesianLearning
from torchdt.baselines.detect.spectrum import sparse_spectrum
from torchdt.model.measurement import Measurement

ORACLE = load_oracle("sparse_bayesian")
"""The plain formulations."""

PEAKS = 256
"""More peaks than are compared."""

DETECT = """
import torch
torch.set_num_threads(int(sys.argv[2]))
detector, measurement = torch.load(sys.argv[1], weights_only=False)
before = kibibytes("VmRSS")
detector(measurement)
print(before, kibibytes("VmHWM"))
"""
"""Detects the points of one step and nothing else."""


def measure_sbl(
    detector: SparseBayesianLearning, steps: Sequence[Measurement], repeats: int
) -> list[Measured]:
    """Sparse Bayesian learning, one step of data at a time, beside two plain formulations in NumPy.

    What is timed of torchdt is all of the detection: the powers, and the peaks moved off the grid and tested.
    Of the plain formulations it is the powers alone.

    Args:
        detector: in one field for all data.
        steps: of data, each without a batch.
        repeats: of every step, and iterations with outer products; medians count.
    """
    device = steps[0].factor.device
    detector(steps[0])
    seconds, plain = [], []
    for step in steps:
        call = partial(detector, step)
        seconds.append(median(clock(call, device)[0] for _ in range(repeats)))
        plain.append(beside_matrix_products(detector, step))
    precision = str(detector.region.low.dtype).removeprefix("torch.")
    limits = f"prune {detector.config.prune:g}, at most {detector.config.max_iterations} iterations"
    note = f"{precision}, grid {detector.region.grid_shape}, {limits}"
    own = Measured("sbl", "torchdt", median(seconds), "s/step", note)
    iteration = clock_outer_products(detector, steps[0], repeats)
    beside = plain_rows(seconds, plain, iteration, repeats)
    return [own, *beside, *measure_memory(detector, steps[0])]


def plain_problem(detector: SparseBayesianLearning, step: Measurement) -> tuple[NDArray, NDArray]:
    """Dictionary `(I, M, C)` and scatter / J `(I, M, M)` in double precision."""
    factor = step.factor.to(torch.complex128)
    scatter = factor @ factor.mH / step.num_snapshots[..., None, None]
    columns = detector.dictionary.response.mT.to(torch.complex128).contiguous()
    return columns.cpu().numpy(), scatter.cpu().numpy()


def beside_matrix_products(detector: SparseBayesianLearning, step: Measurement) -> Plain:
    """Run one step in NumPy to its end."""
    problem, grid, config = plain_problem(detector, step), detector.region.grid_shape, detector.config
    limits = {key: getattr(config, key) for key in ("tolerance", "min_iterations", "max_iterations")}
    learn = partial(ORACLE.learn, *problem, grid, config.sources)
    learn(max_iterations=1)
    seconds, learned = clock(partial(learn, **limits))
    layout = Grid.of(detector.region)
    own = sparse_spectrum(detector.dictionary.response, step, layout, config)
    peaks = (high_peaks(power, layout) for power in (torch.from_numpy(learned.power), own.power))
    return Plain(seconds, learned.iterations, int(own.iterations), *peaks)


def clock_outer_products(detector: SparseBayesianLearning, step: Measurement, repeats: int) -> float:
    """Median seconds of an iteration with an M x M matrix for every column."""
    seconds: list[float] = []

    def sums(*arguments: NDArray) -> tuple[NDArray, NDArray]:
        taken, result = clock(partial(ORACLE.outer_products, *arguments))
        seconds.append(taken)
        return result

    problem, grid = plain_problem(detector, step), detector.region.grid_shape
    ORACLE.learn(*problem, grid, detector.config.sources, sums, max_iterations=repeats + 1)
    return median(seconds[1:])


def high_peaks(power: Tensor, layout: Grid) -> set[int]:
    """Cells of all local maxima of `(C,)` powers above `HIGH` of the largest."""
    kept = torch.where(power > HIGH * power.max(), power, 0.0)
    cell, present = find_peaks(kept, layout, PEAKS, 1.0)
    return set(cell[present].tolist())


def measure_memory(detector: SparseBayesianLearning, step: Measurement) -> list[Measured]:
    """Resident set of a fresh process of this machine that detects the points of one step."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "step.pt"
        torch.save((detector, step), path)
        before, peak = probe(DETECT, str(path), str(torch.get_num_threads()))
    note = "fresh process, PyTorch and dictionary included"
    above = "above what it held before detection"
    return [
        Measured("sbl", "peak memory of torchdt", peak / 1024, "MiB", note),
        Measured("sbl", "peak memory of detection", (peak - before) / 1024, "MiB", above),
    ]
