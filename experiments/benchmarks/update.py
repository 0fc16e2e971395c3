"""Time of the update of one step, beside plain formulations of the same mathematics."""

from collections.abc import Callable
from functools import partial
from operator import truediv
from statistics import median
from typing import Any

import torch
from torch import Tensor

from benchmarks.clock import SIZE, clock_in_turn
from benchmarks.oracle import load_oracle
from benchmarks.problem import random_problem
from benchmarks.report import Measured
from torchdt.core.trees import take_sequences
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.update import update
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise
from torchdt.run.chunks import MOST_ON_CPU, plan, run_chunks

ORACLE = load_oracle("plain_bp")
"""The plain formulations."""

VISITS = 3
"""Visits of one object in one tone that are timed where every particle has a factorisation of its own."""

QUIET = 0.35
"""Data are scaled by it. Were they louder, all objects would exist beyond doubt and all methods agree."""

Row = tuple[str, float, str, str]


def measure_update(
    device: str,
    repeats: int,
    *,
    slots: int = 16,
    particles: int = 1000,
    tones: int = 7,
    sensors: int = 21,
    snapshots: int = 3,
    power_points: int = 16,
    noise_points: int = 64,
    sweeps: int = 3,
    batch: int = 16,
) -> list[Measured]:
    """Sequential BP update of a random step, of one sequence and of a batch, beside NumPy.

    All slots are in use. Workers share out the batch as in tracking. torchdt runs in single precision,
    NumPy in double. Everything is timed in turn, and ratios are medians over the rounds.

    Args:
        device: of torchdt.
        repeats: rounds.
        slots, particles, tones, sensors, snapshots: N, P, I, M and J.
        power_points, noise_points: support points of each power and of each noise variance.
        sweeps: of the update.
        batch: sequences.
    """
    sizes = (slots, particles, tones, sensors, snapshots, power_points, noise_points)
    one, many = (quieten(*random_problem(b, *sizes, torch.float32, device, 0)) for b in ((), (batch,)))
    run = torch.inference_mode()(partial(update, sweeps=sweeps))
    workers = torch.get_num_threads()
    chunks = plan(batch, 1, 1.0, workers, MOST_ON_CPU)
    rows_of = torch.arange(batch, device=device)
    parts = {chunk.start: take_sequences(many, rows_of[chunk]) for chunk in chunks}

    def some(chunk: slice, check: Callable[[], None]) -> Beliefs:
        return run(*parts[chunk.start])

    square = torch.ones(SIZE, SIZE, device=device)
    calls: dict[str, Callable[[], Any]] = {
        "one": partial(run, *one),
        "many": partial(run_chunks, some, chunks, workers),
        "product": partial(torch.matmul, square, square),
    }
    plain = plain_problem(*one)
    expected = ORACLE.update(plain, sweeps)
    calls["plain"] = partial(ORACLE.update, plain, sweeps)
    calls["cholesky"] = partial(factorise_particles, plain, expected)
    seconds = clock_in_turn(calls, repeats, device)
    seconds["many"] = [taken / batch for taken in seconds["many"]]

    size = f"{slots} objects, {particles} particles, {tones} tones, {sensors} sensors, {snapshots} snapshots"
    size = f"{size}, {power_points} power and {noise_points} noise points, {sweeps} sweeps"
    shared = f"of each sequence; workers {workers}, as many as threads"
    rows: list[Row] = [
        ("torchdt", 1e3 * median(seconds["one"]), "ms/step", f"float32; {size}"),
        (f"torchdt, batch of {batch}", 1e3 * median(seconds["many"]), "ms/step", shared),
    ]
    visits = sweeps * slots * tones
    visit = count_operations(particles, sensors, many[3].factor.shape[-1])
    rows += product_rows(visits * visit, seconds["many"], seconds["product"])
    seconds["cholesky"] = [taken * visits / min(VISITS, tones) for taken in seconds["cholesky"]]
    rows += plain_rows(seconds, batch, visits)
    rows += agreement_rows(run(*one), expected)
    return [Measured("update", *row) for row in rows]


def quieten(
    prior: Objects, response: Tensor, noise: Noise, measurement: Measurement
) -> tuple[Objects, Tensor, Noise, Measurement]:
    """A problem whose data leave some of the objects out."""
    return prior, response, noise, measurement._replace(factor=QUIET * measurement.factor)


def plain_problem(prior: Objects, response: Tensor, noise: Noise, measurement: Measurement) -> Any:
    """The arguments of an update of one sequence, for the plain formulations."""
    tensors = (
        *(prior.log_weight, prior.log_odds, prior.power, prior.log_power_weight),
        *(response, noise.variance, noise.log_weight, *measurement),
    )
    return ORACLE.make_problem(*(tensor.cpu().numpy() for tensor in tensors))


def factorise_particles(problem: Any, posterior: Any) -> None:
    """Visit the first object in the first `VISITS` tones: one factorisation per particle, at one power."""
    for i, tone in enumerate(problem.tones[:VISITS]):
        eta = tone.variance.mean()
        background = ORACLE.background(posterior.strength[1:, i], posterior.moment[i][1:], eta)
        ORACLE.by_cholesky(background, tone.response[0], tone.power[0, :1], tone.factor, tone.J)


def count_operations(particles: int, sensors: int, columns: int) -> int:
    """Real operations in matrix products of one visit of one object in one tone.

    The quadratic forms of all particles are P M (M + R) complex multiplications and additions, the second
    moment P M^2; each is 8 real operations.

    Args:
        particles: P.
        sensors: M.
        columns: R, of the factor of the scatter matrix.
    """
    return 8 * particles * sensors * (2 * sensors + columns)


def product_rows(operations: int, seconds: list[float], product: list[float]) -> list[Row]:
    """Rate of the matrix products of an update, alone and as a share of what the machine reaches.

    Args:
        operations: real ones, in the matrix products of an update.
        seconds: of the update, whatever else it does included.
        product: seconds of `2 SIZE^3` operations in a product of two real matrices.
    """
    rate = [operations / taken for taken in seconds]
    share = [r * taken / (2 * SIZE**3) for r, taken in zip(rate, product, strict=True)]
    limit = f"of one {SIZE} x {SIZE} product in single precision; all else the update does counts as time"
    return [
        ("matrix products, batch", 1e-9 * median(rate), "GFLOP/s", f"{operations:.3g} operations a sequence"),
        ("matrix products / machine", median(share), "ratio", limit),
    ]


def agreement_rows(found: Beliefs, expected: Any) -> list[Row]:
    """How far torchdt is from the plain formulation in double precision."""
    existence = torch.from_numpy(expected.log_odds).sigmoid()
    strength = torch.from_numpy(expected.strength)
    apart = (found.objects.log_odds.cpu().double().sigmoid() - existence).abs().max()
    relative = (found.strength.cpu() - strength).abs().max() / strength.max()
    note = "largest, torchdt and NumPy"
    return [
        ("difference of existence", float(apart), "probability", note),
        ("difference of existence x power", float(relative), "of the largest", note),
    ]


def plain_rows(seconds: dict[str, list[float]], batch: int, visits: int) -> list[Row]:
    """Times of the plain formulations and their ratios to torchdt's, by round."""

    def ratio(name: str, own: str) -> float:
        return median(map(truediv, seconds[name], seconds[own]))

    cholesky = 1e3 * median(seconds["cholesky"])
    few = f"EXTRAPOLATED: {cholesky / visits:.3g} ms of a visit of one object in one tone, x {visits} visits"
    return [
        ("NumPy", 1e3 * median(seconds["plain"]), "ms/step", "double precision, rank-one formula"),
        ("one Cholesky per particle", cholesky, "ms/step", f"{few}; double precision, one power point"),
        ("NumPy / torchdt", ratio("plain", "one"), "ratio", ""),
        (f"NumPy / torchdt, batch of {batch}", ratio("plain", "many"), "ratio", "of each sequence"),
        ("one Cholesky per particle / torchdt", ratio("cholesky", "one"), "ratio", "EXTRAPOLATED, likewise"),
    ]
