"""Random problems for the BP update of one step."""

import math

import torch
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.noise.base import Noise

NOISE_VARIANCE = 0.05
"""Of each tone, beside powers around one."""


def random_problem(
    batch: tuple[int, ...],
    slots: int,
    particles: int,
    tones: int,
    sensors: int,
    snapshots: int,
    power_points: int,
    noise_points: int,
    dtype: torch.dtype,
    device: str | torch.device,
    seed: int,
) -> tuple[Objects, Tensor, Noise, Measurement]:
    """Objects that probably exist, and data in which each sends from its first particle.

    Responses are random directions of unit norm; existence probabilities are from 0.5 to 0.99.

    Args:
        batch: leading dimensions.
        slots: N.
        particles: P, of each object.
        tones: I.
        sensors: M.
        snapshots: J.
        power_points: G, of each tone's power.
        noise_points: E, of each tone's noise variance.
        dtype: real type.
        device: of the tensors.
        seed: of the first sequence; the others count on, and are what they would be alone.

    Returns:
        Predicted objects of batch `(*batch, N)`, responses `(*batch, N, I, P, M)` complex, predicted noise
        and the measurement: the arguments of `torchdt.filter.bp.schedule.update`.
    """
    streams = RandomStreams.from_seeds(range(seed, seed + math.prod(batch)), batch, dtype, device)

    def normal(*shape: int) -> Tensor:
        return torch.view_as_complex(streams.normal(*shape, 2)) / math.sqrt(2)

    response = normal(slots, tones, particles, sensors)
    response /= torch.linalg.vector_norm(response, dim=-1, keepdim=True)
    log_power = 2 * streams.uniform(slots, tones, 1) - 1
    amplitude = normal(slots, tones, snapshots, 1) * (log_power / 2).exp()[..., None]
    background = math.sqrt(NOISE_VARIANCE) * normal(tones, snapshots, sensors)
    received = (amplitude * response[..., :1, :]).sum(-4) + background
    spread = torch.linspace(-1, 1, power_points, dtype=dtype, device=device)
    level = torch.linspace(-1, 1, noise_points, dtype=dtype, device=device).exp() * NOISE_VARIANCE
    objects = Objects(
        state=streams.normal(slots, particles, 2),
        log_weight=_even(log_power.new_empty(*batch, slots, particles)),
        power=(log_power + spread).exp(),
        log_power_weight=_even(log_power.new_empty(*batch, slots, tones, power_points)),
        log_odds=torch.logit(0.5 + 0.49 * streams.uniform(slots)),
        label=torch.zeros(*batch, slots, dtype=torch.int64, device=device),
        transmits=log_power.new_ones((*batch, slots, particles)),
    )
    variance = level.expand(*batch, tones, noise_points)
    return objects, response, Noise(variance, _even(torch.empty_like(variance))), from_snapshots(received)


def _even(tensor: Tensor) -> Tensor:
    """Equal log-weights over the last dimension, of the tensor's shape."""
    return torch.full_like(tensor, -math.log(tensor.shape[-1]))
