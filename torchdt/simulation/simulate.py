"""Array snapshots of simulated sources in noise."""

import math

import torch
from scipy.interpolate import CubicSpline
from torch import Generator, Tensor

from torchdt.field.base import Field
from torchdt.simulation.settings import PathSettings, ScenarioSettings, SourceSettings


def source_track(source: SourceSettings, path: PathSettings, num_steps: int, step_s: float) -> Tensor:
    """Position of a source in every step, `(K, d)` float64, NaN while it is absent."""
    times = torch.arange(num_steps, dtype=torch.float64) * step_s
    if source.frozen_step is not None:
        times = torch.full_like(times, source.frozen_step * step_s)
    position = position_along(path, times)
    position[: source.birth] = torch.nan
    if source.death is not None:
        position[source.death :] = torch.nan
    return position


def position_along(path: PathSettings, times: Tensor) -> Tensor:
    """Positions `(K, d)` float64 on a path at times `(K,)` s: a cubic spline through its points."""
    knots = torch.tensor(path.positions, dtype=torch.float64)
    if len(knots) >= 3:
        return torch.from_numpy(CubicSpline(path.times_s, knots.numpy())(times.numpy()))
    if len(knots) == 2:
        share = (times - path.times_s[0]) / (path.times_s[1] - path.times_s[0])
        return torch.lerp(knots[0], knots[1], share[:, None])
    return knots.expand(len(times), -1).clone()


def simulate_snapshots(
    field: Field, scenario: ScenarioSettings, generator: Generator
) -> tuple[Tensor, Tensor]:
    """Draw `z = sum_l rho_l a(x_l) + noise` of one sequence (Liang and Meyer, eq. 1).

    The noise variance follows from the signal-to-noise ratio: a source of 0 dB and unit-norm response has
    the power 1 / M per element.

    Args:
        field: response in float64.
        scenario: what to simulate.
        generator: random numbers.

    Returns:
        Snapshots `(K, I, J, M)` complex128 and true positions `(K, L, d)` float64, NaN while absent.
    """
    shape = (scenario.num_steps, field.num_tones, scenario.num_snapshots)
    scale = math.sqrt(noise_variance(field, scenario))
    snapshots = scale * complex_normal((*shape, field.num_sensors), generator)
    truth = torch.full(
        (scenario.num_steps, len(scenario.sources), len(scenario.coordinates)), torch.nan
    ).double()
    for index, source in enumerate(scenario.sources.values()):
        truth[:, index] = position = _track_in(scenario, source)
        rho = amplitudes(scenario, shape, generator)
        snapshots = snapshots + _sent(field, source, position, rho)
    return snapshots, truth


def simulate_interference(field: Field, scenario: ScenarioSettings, generator: Generator) -> Tensor:
    """What the array receives of the interferers, `(K, I, J, M)` complex128, see `simulate_snapshots`."""
    shape = (scenario.num_steps, field.num_tones, scenario.num_snapshots)
    total = torch.zeros((*shape, field.num_sensors), dtype=torch.complex128)
    for source in scenario.interferers.values():
        rho = complex_normal(shape, generator)
        total = total + _sent(field, source, _track_in(scenario, source), rho)
    return total


def _track_in(scenario: ScenarioSettings, source: SourceSettings) -> Tensor:
    return source_track(source, scenario.paths[source.path], scenario.num_steps, scenario.step_s)


def _sent(field: Field, source: SourceSettings, position: Tensor, rho: Tensor) -> Tensor:
    """What is received of a source at `(K, d)` with unit-power amplitudes `(K, I, J)`."""
    sending = position.clone()
    for first, last in source.silences:
        sending[first : last + 1] = torch.nan
    if source.frozen_step is not None:
        rho = rho[:1].expand_as(rho)
    return received(field, sending, 10 ** (source.power_db / 20) * rho)


def noise_variance(field: Field, scenario: ScenarioSettings) -> float:
    """Noise variance per element that the scenario's signal-to-noise ratio stands for."""
    return 10 ** (-scenario.snr_db / 10) / field.num_sensors


def received(field: Field, position: Tensor, amplitude: Tensor) -> Tensor:
    """What the array receives of one source.

    Args:
        field: the array response.
        position: `(K, d)`, NaN where the source sends nothing.
        amplitude: `(K, I, J)` complex.

    Returns:
        `(K, I, J, M)` complex, zero where the source sends nothing.
    """
    sending = ~position.isnan().any(-1)
    response = field(torch.where(sending[:, None], position, 1.0))
    signal = amplitude[..., None] * response[..., None, :]
    return torch.where(sending[:, None, None, None], signal, 0.0)


def amplitudes(scenario: ScenarioSettings, shape: tuple[int, int, int], generator: Generator) -> Tensor:
    """Unit-power amplitudes `(K, I, J)` of one source."""
    if scenario.amplitudes == "gaussian":
        return complex_normal(shape, generator)
    num_steps, num_tones, num_snapshots = shape
    walk = torch.randn(num_tones, num_steps * num_snapshots, generator=generator, dtype=torch.float64)
    start = 2 * math.pi * torch.rand(num_tones, 1, generator=generator, dtype=torch.float64)
    phase = start + math.radians(scenario.phase_step_deg) * walk.cumsum(-1)
    return torch.polar(torch.ones_like(phase), phase).reshape(num_tones, num_steps, -1).transpose(0, 1)


def complex_normal(shape: tuple[int, ...], generator: Generator) -> Tensor:
    """Standard circular complex normal draws, complex128."""
    return torch.randn(shape, generator=generator, dtype=torch.complex128)
