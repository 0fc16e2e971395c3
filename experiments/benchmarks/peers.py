"""Time of a plain particle filter of one object, beside what other packages need for the same work.

Predict by the constant-rate model, weight by a Gaussian likelihood of the measured position, resample
systematically. A package that is not installed is left out.
"""

import importlib.util
import math
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from functools import partial
from statistics import median
from typing import Any

import torch
from torch import Tensor

from benchmarks.clock import clock, clock_in_turn
from benchmarks.report import Measured
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import stop_gradient_weights, systematic_indices
from torchdt.core.weights import normalise
from torchdt.model.motion.constant_velocity import predict_state
from torchdt.model.motion.driving import Score, drive

STEP_S, DRIVING, SPREAD, RATE = 1.0, 0.05, 10.0, 1.0
"""Step in s; driving noise in (m/s^2)^2; deviation of measured positions in m, of rates at first in m/s."""

WARM_UP, TIMED = 5, 20
"""Steps of each filter before and while the clock runs, for each repeat."""

Step = Callable[[Any, Tensor], Any]
"""From particles and a measured position `(2,)` to particles."""


def measure_peers(counts: Sequence[int], repeats: int, device: str) -> list[Measured]:
    """One step of each filter, by number of particles.

    Args:
        counts: numbers of particles.
        repeats: measurement sequences, of seeds from 0 up; the filters take turns at every step.
        device: of torchdt; the others run on the CPU.
    """
    rows: list[Measured] = []
    for count in counts:
        rows += beside_stone_soup(count, repeats, device) + differentiable(count, repeats, device)
    return rows


def beside_stone_soup(count: int, repeats: int, device: str) -> list[Measured]:
    """A step of torchdt and one of Stone Soup, both on the same measurements."""
    there = importlib.util.find_spec("stonesoup") is not None
    own_seconds: list[float] = []
    other_seconds: list[float] = []
    apart: list[float] = []
    for seed in range(repeats):
        streams = RandomStreams.from_seeds([seed], (), torch.float32, device)
        first, *measured = measure_walk(streams)
        filters = [own_filter(first, count, streams)]
        if there:
            filters.append(stone_soup_filter(first, count))
        seconds, particles = follow(filters, measured, device)
        own_seconds += seconds[0]
        if there:
            other_seconds += seconds[1]
            means = (particles[0][:, :2].mean(0).tolist(), positions_of(particles[1]).mean(0).tolist())
            apart.append(math.dist(*means))
    size, own = f"{count} particles", 1e3 * median(own_seconds)
    found = [(f"torchdt, {size}", own, "ms/step", "single precision, one object")]
    if there:
        other = 1e3 * median(other_seconds)
        found += [
            (f"Stone Soup, {size}", other, "ms/step", "double precision, white noise acceleration"),
            (f"Stone Soup / torchdt, {size}", other / own, "ratio", ""),
            (f"between the estimates, {size}", median(apart), "m", f"positions measured to {SPREAD:g} m"),
        ]
    else:
        found.append((f"Stone Soup, {size}", math.nan, "ms/step", "left out: not installed"))
    return [Measured("peers", *row) for row in found]


def follow(
    filters: Sequence[tuple[Any, Step]], measured: Sequence[Tensor], device: str
) -> tuple[list[list[float]], list[Any]]:
    """Seconds of every step after the first few, and the particles at the end, of filters that take turns."""
    particles = [start for start, _ in filters]
    seconds: list[list[float]] = [[] for _ in filters]
    for k, position in enumerate(measured):
        for n, (_, step) in enumerate(filters):
            taken, particles[n] = clock(partial(step, particles[n], position), device)
            if k >= WARM_UP:
                seconds[n].append(taken)
    return seconds, particles


def differentiable(count: int, repeats: int, device: str) -> list[Measured]:
    """A step forward and, from its log-likelihood, back to the driving variance and the measurement noise."""
    streams = RandomStreams.from_seeds([0], (), torch.float32, device)
    first, position = measure_walk(streams)[:2]
    particles, _ = own_filter(first, count, streams)
    driving, spread = (particles.new_tensor([v, v]).requires_grad_() for v in (DRIVING, SPREAD))

    def forward_and_back() -> None:
        _, _, log_evidence = filter_step(particles, position, driving, spread, streams)
        torch.autograd.grad(log_evidence, (driving, spread))

    taken = clock_in_turn({"torchdt": forward_and_back}, TIMED * repeats, device)["torchdt"]
    absent = importlib.util.find_spec("pydpf") is None
    reason = "not installed" if absent else "nothing here calls it"
    rows = [
        (f"torchdt, forward and back, {count} particles", 1e3 * median(taken), "two numbers"),
        (f"pydpf, forward and back, {count} particles", math.nan, f"left out: {reason}"),
    ]
    return [Measured("peers", name, value, "ms/step", note) for name, value, note in rows]


def measure_walk(streams: RandomStreams) -> Tensor:
    """Measured positions `(1 + WARM_UP + TIMED, 2)` m of an object that moves at 1 m/s in each coordinate."""
    noise = SPREAD * streams.normal(1 + WARM_UP + TIMED, 2)
    return noise + RATE * STEP_S * torch.arange(len(noise), device=noise.device)[:, None]


def filter_step(
    particles: Tensor, position: Tensor, driving: Tensor, spread: Tensor, streams: RandomStreams
) -> tuple[Tensor, Tensor, Tensor]:
    """One step of a particle filter, differentiable in its two numbers.

    Args:
        particles: `(P, 4)` of equal weight: positions in m, rates in m/s.
        position: `(2,)` measured.
        driving: `(2,)` variance of the driving noise, (m/s^2)^2.
        spread: `(2,)` standard deviation of the measurement, m.
        streams: random numbers.

    Returns:
        Resampled particles; their log-weights `(P,)`, even but for their gradient; `log p(z_k | z_1..k-1)`.
    """
    noise, log_ratio = drive(streams.normal(len(particles), 2), driving, Score())
    moved = predict_state(particles, noise, STEP_S)
    density = torch.distributions.Normal(moved[:, :2], spread, validate_args=False)
    log_weight, log_evidence = normalise(
        log_ratio - math.log(len(particles)) + density.log_prob(position).sum(-1)
    )
    ancestors = systematic_indices(log_weight, streams.uniform(1)[0])
    return moved[ancestors], stop_gradient_weights(log_weight, ancestors), log_evidence


def own_filter(first: Tensor, count: int, streams: RandomStreams) -> tuple[Tensor, Step]:
    """Particles `(count, 4)` around the first measurement, and a step of torchdt."""
    driving, spread = first.new_tensor([DRIVING, DRIVING]), first.new_tensor([SPREAD, SPREAD])
    draws = streams.normal(count, 4)
    particles = torch.cat([first + SPREAD * draws[:, :2], RATE * draws[:, 2:]], -1)

    def step(particles: Tensor, position: Tensor) -> Tensor:
        with torch.inference_mode():
            return filter_step(particles, position, driving, spread, streams)[0]

    return particles, step


def stone_soup_filter(first: Tensor, count: int) -> tuple[Any, Step]:
    """A particle state of Stone Soup around the first measurement, and a step of its particle filter.

    White noise acceleration of density q gives rates the variance q T in a step: that of the driving noise.
    """
    import numpy as np
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.resampler.particle import SystematicResampler
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import ParticleState
    from stonesoup.updater.particle import ParticleUpdater

    density = DRIVING * STEP_S
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(density), ConstantVelocity(density)])
    model = LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=np.diag([SPREAD**2, SPREAD**2]))
    predictor, updater = ParticlePredictor(motion), ParticleUpdater(model, SystematicResampler())
    draws = np.random.default_rng(0).standard_normal((4, count))
    start = first.cpu().numpy()
    rows = [start[0] + SPREAD * draws[0], RATE * draws[1], start[1] + SPREAD * draws[2], RATE * draws[3]]
    state = ParticleState(
        StateVectors(np.stack(rows)), timestamp=datetime(2000, 1, 1), weight=np.full(count, 1 / count)
    )

    def step(state: Any, position: Tensor) -> Any:
        now = state.timestamp + timedelta(seconds=STEP_S)
        predicted = predictor.predict(state, timestamp=now)
        detection = Detection(position.cpu().numpy()[:, None], timestamp=now)
        return updater.update(SingleHypothesis(predicted, detection))

    return state, step


def positions_of(state: Any) -> Tensor:
    """Positions `(P, 2)` of a particle state of Stone Soup."""
    return torch.as_tensor(state.state_vector[[0, 2]].astype(float)).mT
