"""Two-object scenes on a line array, small enough to enumerate."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import torch
from oracles.enumeration import Marginals, Problem, enumerate_pair
from torch import Tensor

from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.noise.base import Noise

NUM_SENSORS, NUM_TONES, NUM_SNAPSHOTS, NUM_STATES = 8, 7, 3, 120

LEFT_RIGHT = ((-40.0, 0.0), (5.0, 45.0))
OVERLAPPING = ((-30.0, 10.0), (0.0, 30.0))
TOUCHING = ((-30.0, -10.0), (-9.5, 20.0))
SAME = ((-30.0, 30.0), (-30.0, 30.0))

# Unambiguous: sources at least a beamwidth (14 degrees) apart, and every number of objects that has an
# exact probability above 0.05 is the true one. Truth bearings, powers, regions.
UNAMBIGUOUS = {
    "nothing there": ((), (), LEFT_RIGHT),
    "one of two": ((-20.0,), (4.0,), LEFT_RIGHT),
    "separated": ((-20.0, 25.0), (4.0, 4.0), LEFT_RIGHT),
    "partly overlapping regions": ((-10.0, 18.0), (4.0, 4.0), OVERLAPPING),
    "beside a strong source": ((-12.0,), (16.0,), TOUCHING),
    "weak beside strong": ((-12.0, 10.0), (16.0, 1.0), TOUCHING),
    "one in the same region": ((5.0,), (4.0,), SAME),
    "two in the same region": ((-15.0, 12.0), (8.0, 2.0), SAME),
}


@dataclass(frozen=True)
class Scene:
    """One enumerated scene: for the oracle, and as tensors for BP."""

    problem: Problem
    prior: Objects
    response: Tensor
    noise: Noise
    measurement: Measurement


def steering(bearing_deg: np.ndarray) -> np.ndarray:
    """Unit-norm plane-wave responses (X, I, M); tones from half to full design frequency."""
    tones = np.linspace(0.5, 1.0, NUM_TONES)
    phase = np.pi * np.sin(np.deg2rad(bearing_deg))[:, None, None] * tones[:, None] * np.arange(NUM_SENSORS)
    return np.exp(-1j * phase) / np.sqrt(NUM_SENSORS)


def make_scene(
    seed: int,
    truth_deg: tuple[float, ...],
    truth_power: tuple[float, ...],
    regions: tuple[tuple[float, float], tuple[float, float]],
    noise_variance: float = 0.05,
    prior_existence: tuple[float, float] = (0.1, 0.1),
    num_power: int = 4,
    num_noise: int = 3,
) -> Scene:
    """Simulate Gaussian amplitudes and lay out the grids of both potential objects."""
    rng = np.random.default_rng(seed)

    def complex_normal(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    z = np.sqrt(noise_variance) * complex_normal(NUM_TONES, NUM_SNAPSHOTS, NUM_SENSORS)
    for bearing, power in zip(truth_deg, truth_power, strict=True):
        amplitude = np.sqrt(power) * complex_normal(NUM_TONES, NUM_SNAPSHOTS, 1)
        z = z + amplitude * steering(np.array([bearing]))[0][:, None, :]
    grids = [np.linspace(low, high, NUM_STATES) for low, high in regions]
    power = np.tile(np.geomspace(0.25, 16.0, num_power), (NUM_TONES, 1))
    noise = np.tile(
        noise_variance * np.geomspace(0.7, 1.4, num_noise) if num_noise > 1 else [noise_variance],
        (NUM_TONES, 1),
    )
    responses = [steering(g) for g in grids]
    uniform = np.full(NUM_STATES, -np.log(NUM_STATES))
    log_power, log_noise = np.full_like(power, -np.log(num_power)), np.full_like(noise, -np.log(num_noise))
    problem = Problem(
        (responses[0], responses[1]),
        (uniform, uniform),
        prior_existence,
        power,
        log_power,
        noise,
        log_noise,
        np.einsum("ijm,ijk->imk", z, z.conj()),
        NUM_SNAPSHOTS,
    )
    prior_r = torch.tensor(prior_existence, dtype=torch.float64)
    prior = Objects(
        state=torch.tensor(np.stack(grids))[..., None],
        log_weight=torch.tensor(np.stack([uniform, uniform])),
        power=torch.tensor(power).expand(2, -1, -1),
        log_power_weight=torch.tensor(log_power).expand(2, -1, -1),
        log_odds=torch.logit(prior_r),
        label=torch.zeros(2, dtype=torch.int64),
        transmits=torch.ones(2, uniform.shape[-1], dtype=torch.float64),
    )
    response = torch.tensor(np.stack(responses)).transpose(-3, -2).contiguous()
    return Scene(
        problem,
        prior,
        response,
        Noise(torch.tensor(noise), torch.tensor(log_noise)),
        from_snapshots(torch.tensor(z)),
    )


@cache
def unambiguous(case: str, seed: int) -> tuple[Scene, Marginals]:
    """One of the `UNAMBIGUOUS` scenes and its exact answer, which several tests share."""
    scene = make_scene(seed, *UNAMBIGUOUS[case])
    return scene, enumerate_pair(scene.problem)


def repeat(tree: Any, runs: int) -> Any:
    """A (nested) tuple of tensors with a leading dimension of equal copies."""
    if isinstance(tree, Tensor):
        return tree.expand(runs, *tree.shape)
    return tree if tree is None else type(tree)(*(repeat(t, runs) for t in tree))
