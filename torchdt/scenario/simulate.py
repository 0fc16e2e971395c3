"""Array snapshots of simulated sources in noise."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Generator, Tensor

from torchdt.field.base import Field

Amplitudes = Literal["gaussian", "constant_modulus"]


@dataclass(frozen=True, eq=False)
class SourceTrack:
    """One simulated source.

    Attributes:
        position: `(K, d)` float64; NaN while the source is absent.
        power: linear, relative to a source of 0 dB.
        silent: `(K,)` bool, steps in which it is there but sends nothing.
        frozen: repeat one step's snapshots in every step.
    """

    position: Tensor
    power: float
    silent: Tensor
    frozen: bool


def simulate_snapshots(
    field: Field,
    sources: list[SourceTrack],
    *,
    num_snapshots: int,
    noise_variance: float,
    amplitudes: Amplitudes,
    phase_step_deg: float,
    generator: Generator,
) -> Tensor:
    """Draw `z = sum_l rho_l a(x_l) + noise` of one sequence (Liang and Meyer, eq. 1).

    Args:
        field: response in float64.
        sources: at least none; all of the same number of steps K.
        num_snapshots: J per step.
        noise_variance: eta; with no sources and eta = 1 a unit noise recording.
        amplitudes: `gaussian`, independent from snapshot to snapshot, or `constant_modulus`, as a projector
            sends them: the phase walks by a normal step of `phase_step_deg` per snapshot.
        phase_step_deg: standard deviation of that step, degrees.
        generator: random numbers.

    Returns:
        `(K, I, J, M)` complex128.
    """
    num_steps = sources[0].position.shape[0]
    shape = (num_steps, field.num_tones, num_snapshots)
    snapshots = math.sqrt(noise_variance) * _complex_normal((*shape, field.num_sensors), generator)
    for source in sources:
        if amplitudes == "gaussian":
            rho = _complex_normal(shape, generator)
        else:
            walk = torch.randn(shape, generator=generator, dtype=torch.float64) * math.radians(phase_step_deg)
            start = 2 * math.pi * torch.rand(shape[1], generator=generator, dtype=torch.float64)
            # Snapshots follow one another within a step, steps follow one another per tone.
            phase = walk.transpose(0, 1).flatten(1).cumsum(-1) + start[:, None]
            rho = torch.polar(torch.ones_like(phase), phase).reshape(shape[1], num_steps, -1).transpose(0, 1)
        if source.frozen:
            rho = rho[:1].expand(shape)
        present = ~source.position.isnan().any(-1) & ~source.silent
        response = field(torch.where(present[:, None], source.position, 1.0))
        signal = math.sqrt(source.power) * rho[..., None] * response[..., None, :]
        snapshots = snapshots + torch.where(present[:, None, None, None], signal, 0.0)
    return snapshots


def _complex_normal(shape: tuple[int, ...], generator: Generator) -> Tensor:
    return torch.randn(shape, generator=generator, dtype=torch.complex128)
