"""Signals that are no objects, and a noise of which nothing is known."""

import torch
from oracles.arrays import complex_normal
from torch import Tensor

from torchdt.model.noise.base import Noise


def any_level(*batch: int) -> Noise:
    """A level from 1e-3 to 1e3, two in a factor of three, all as likely."""
    variance = torch.logspace(-3, 3, 25, dtype=torch.float64).expand(*batch, 25)
    return Noise(variance, torch.zeros_like(variance).log_softmax(-1))


def ship(
    seed: int, steps: int, power: float, *, tones: int = 2, snapshots: int = 3, sensors: int = 8
) -> Tensor:
    """A signal of random spatial signature in each tone that stays, `(K, I, J, M)`."""
    rng = torch.Generator().manual_seed(1000 + seed)
    signature = complex_normal(rng, tones, 1, sensors)
    return power**0.5 * complex_normal(rng, steps, tones, snapshots, 1) * signature
