"""Evidence of a source that shows itself slowly, and its gradient, against a filter of particles."""

import math

import pytest
import torch
from oracles.line_array import make_field, make_tracker, simulate
from oracles.undetected import F64, Levels, run_particles
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.filter.direct import DirectTracker
from torchdt.filter.intensity.settings import Intensity
from torchdt.filter.likelihood import log_likelihood
from torchdt.model.gamma_chain import log_walk
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.base import Noise
from torchdt.model.prior import data_priors

pytestmark = pytest.mark.slow
NOISE, STEPS, RUNS = 1 / 8, 30, 4
BIRTH, SURVIVAL, SHAPE = 1e-3, 0.95, 1e4


class KnownNoise(DirectTracker):
    """A tracker that is told the noise."""

    def init(self, priors):
        point = torch.full((*priors.noise_max.shape, 1), NOISE, dtype=F64)
        return super().init(priors)._replace(noise=Noise(point, torch.zeros_like(point)))


def tracked(snapshots: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Evidence over that of noise `(B, K)`, and gradients `(B,)` of its sum in births and survival."""
    numbers = {"birth_mean": BIRTH, "survival": SURVIVAL}
    leaves = {n: torch.full((RUNS,), v, dtype=F64, requires_grad=True) for n, v in numbers.items()}
    plain = make_tracker(power_shape=SHAPE, noise_shape=1e12)
    model = plain.model.with_numbers(leaves)
    tracker = KnownNoise(make_field(), plain.region, 1.0, plain.config, model)
    measurement = from_snapshots(snapshots)
    streams = RandomStreams.from_seeds(range(RUNS), (RUNS,), F64)
    found = log_likelihood(tracker, measurement, data_priors(measurement), streams)
    slopes = torch.autograd.grad(found.sum(), list(leaves.values()))
    energy = snapshots.abs().square().sum((-3, -2, -1))
    noise = -energy / NOISE - snapshots[0, 0].numel() * math.log(math.pi * NOISE)
    return found.detach() - noise, list(slopes)


def expected(snapshots: Tensor) -> tuple[Tensor, list[Tensor]]:
    """The same by particles, whose gradients are differences with the same random numbers."""
    settings = Intensity()
    level = settings.level(torch.zeros((), dtype=F64))
    around, share = settings.tone_levels(level)
    levels = Levels(NOISE * around, share, log_walk(level, torch.tensor(SHAPE, dtype=F64)))
    step = 1e-3
    births = BIRTH * torch.tensor([1, 1 + step, 1 - step, 1, 1], dtype=F64)
    survivals = SURVIVAL * torch.tensor([1, 1, 1, 1 + step, 1 - step], dtype=F64)
    limits = (-70.0, 70.0), (-1.0, 1.0), 1e-3
    found = torch.stack(
        [
            run_particles(
                make_field(),
                data,
                NOISE,
                levels,
                *limits,
                births / (1 + births),
                survivals,
                torch.Generator().manual_seed(b),
                particles=2500,
            )
            for b, data in enumerate(snapshots)
        ]
    )
    total = found.sum(1)
    slopes = [
        (total[:, 1] - total[:, 2]) / (2 * step * BIRTH),
        (total[:, 3] - total[:, 4]) / (2 * step * SURVIVAL),
    ]
    return found[..., 0], slopes


@pytest.mark.parametrize("level_db", [-40.0, -11.0])
def test_evidence_and_gradients_are_those_of_particles(level_db):
    """Noise alone, and half a nat to a nat in a step; within 0.05 nats a step and two standard errors."""
    snapshots = torch.stack(
        [
            simulate(
                b,
                ((0.0, -20.0 + 3 * b), (30.0, -10.0 + 3 * b)),
                steps=STEPS,
                snr_db=0.0,
                powers_db=(level_db,),
            )[0]
            for b in range(RUNS)
        ]
    )
    (found, slopes), (value, differences) = tracked(snapshots), expected(snapshots)
    assert (found - value).mean().abs() < (0.05 if level_db > -40 else 1e-4)
    assert (found - value).sum(-1).abs().max() < 0.05 * STEPS * 2
    for slope, difference in zip(slopes, differences, strict=True):
        off = slope - difference
        assert off.mean().abs() < 2 * off.std() / RUNS**0.5
        assert off.mean().abs() < 0.1 * difference.mean().abs()
