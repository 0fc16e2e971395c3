"""Sources and snapshots drawn from the statistical model of the tracker (Liang and Meyer, Sec. II)."""

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from torchdt.core.random import RandomStreams
from torchdt.field.base import Field
from torchdt.model.motion.constant_velocity import predict_state
from torchdt.model.region import Region
from torchdt.simulation.settings import PopulationSettings, ScenarioSettings
from torchdt.simulation.simulate import amplitudes, complex_normal, noise_variance, received


class Population(NamedTuple):
    """All sources that were ever born in one sequence, in order of birth; NaN while absent.

    Attributes:
        state: `(K, L, 2 d)` positions, then rates.
        power: `(K, L, I)` relative to the scenario's reference.
    """

    state: Tensor
    power: Tensor


def generate_snapshots(
    field: Field,
    region: Region,
    scenario: ScenarioSettings,
    population: PopulationSettings,
    generator: Generator,
) -> tuple[Tensor, Tensor]:
    """Draw `z = sum_l sqrt(gamma_l) rho_l a(x_l) + sqrt(eta) eps` of one sequence (Liang and Meyer, eq. 1).

    The noise variance of each tone starts at the scenario's signal-to-noise ratio and follows a Gamma chain.

    Args:
        field: response in float64.
        region: in float64.
        scenario: time axis, snapshots and noise.
        population: how sources come, move and go.
        generator: random numbers.

    Returns:
        Snapshots `(K, I, J, M)` complex128 and true positions `(K, L, d)` float64, NaN while absent. L is the
        number of sources ever born.
    """
    num_steps, step_s = scenario.num_steps, scenario.step_s
    shape = (num_steps, field.num_tones, scenario.num_snapshots)
    sources = draw_population(region, population, num_steps, step_s, field.num_tones, generator)
    eta = torch.full((field.num_tones,), noise_variance(field, scenario), dtype=torch.float64)
    moving = torch.arange(num_steps)[:, None].expand(shape[:2]) > 0
    eta = draw_chain(eta, moving, population.noise_shape, generator)
    snapshots = eta.sqrt()[..., None, None] * complex_normal((*shape, field.num_sensors), generator)
    truth = sources.state[..., : region.num_coordinates]
    for position, power in zip(truth.unbind(1), sources.power.unbind(1), strict=True):
        rho = amplitudes(scenario, shape, generator)
        snapshots = snapshots + received(field, position, power.sqrt()[..., None] * rho)
    return snapshots, truth


def draw_population(
    region: Region,
    population: PopulationSettings,
    num_steps: int,
    step_s: float,
    num_tones: int,
    generator: Generator,
) -> Population:
    """Draw the sources of one sequence (Liang and Meyer, Sec. II-B and IV).

    New ones are a Poisson process, uniform in position and rate. A source lives on with the probability of
    survival and while it is in the region.

    Args:
        region: in float64.
        population: numbers of the model.
        num_steps: K.
        step_s: T, s.
        num_tones: I.
        generator: random numbers.
    """
    draws = RandomStreams([generator], (), torch.float64)
    steps = torch.arange(num_steps)
    # Drawn in the whole box; what is born where no object can be is never there.
    box_mean = population.birth_mean * math.prod(region.grid_shape) / region.num_cells
    mean = torch.full((num_steps,), box_mean, dtype=torch.float64)
    birth = steps.repeat_interleave(torch.poisson(mean, generator=generator).long())
    num_sources, num_coordinates = len(birth), region.num_coordinates
    low, high = torch.cat([region.low, region.rate_low]), torch.cat([region.high, region.rate_high])
    first = torch.lerp(low, high, draws.uniform(num_sources, 2 * num_coordinates))
    states = [first]
    driving = region.driving_variance.sqrt() * draws.normal(num_steps - 1, num_sources, num_coordinates)
    for step, q in enumerate(driving, start=1):
        moved = predict_state(states[-1], q, step_s)
        states.append(torch.where(birth[:, None] < step, moved, first))
    state = torch.stack(states)

    age = steps[:, None] - birth
    survives = draws.uniform(num_steps, num_sources) < population.survival
    lives = (age < 0) | region.contains(state) & ((age == 0) | survives)
    present = (age >= 0) & lives.cumprod(0).bool()
    drawn = draws.uniform(num_sources, num_tones)
    if population.power_density == "uniform":
        weakest, strongest = (10 ** (level / 10) for level in population.power_db)
        first_power = weakest + (strongest - weakest) * drawn
    else:
        weakest, strongest = population.power_db
        first_power = 10 ** ((weakest + (strongest - weakest) * drawn) / 10)
    moving = (age > 0)[..., None].expand(-1, -1, num_tones)
    power = draw_chain(first_power, moving, population.power_shape, generator)

    kept = _admitted(present, birth, population.max_objects)
    state, power = (torch.where(present[..., None], t, torch.nan)[:, kept] for t in (state, power))
    return Population(state, power)


def draw_chain(start: Tensor, moving: Tensor, shape: float, generator: Generator) -> Tensor:
    """Draw Gamma chains, `v' ~ G(v / c, c)`: scale v / c, shape c (Liang and Meyer, Sec. IV).

    Args:
        start: `(*batch,)` first values.
        moving: `(K, *batch)` bool, steps into which there is a transition; the value is kept in all others.
        shape: c.
        generator: random numbers.

    Returns:
        `(K, *batch)`.
    """
    # The sampler behind torch.distributions.Gamma, which takes no generator.
    c = start.new_full(moving.shape, shape)
    gain = torch._standard_gamma(c, generator=generator) / shape
    return start * torch.where(moving, gain, 1.0).cumprod(0)


def _admitted(present: Tensor, birth: Tensor, most: int | None) -> list[int]:
    """Sources that found fewer than `most` others when they were born; the rest is never there."""
    kept: list[int] = []
    for source, step in enumerate(birth.tolist()):
        if most is None or present[step, kept].sum() < most:
            kept.append(source)
    return kept
