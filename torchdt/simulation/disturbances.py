"""What recordings suffer from and the tracker's model does not hold: coloured noise, gains, impulses."""

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import torch
from torch import Generator, Tensor

from torchdt.core.errors import require
from torchdt.core.ranges import FINITE, Checked, Decibels, Each, Range, Share, StepIndex
from torchdt.field.base import Field, as_field

Factor = Annotated[float, Range("a number from 0 up", low=0, most=1e6)]


@dataclass
class NoiseColourSettings(Checked):
    """Noise that is correlated between the sensors, beside the white noise of the scenario.

    Attributes:
        level_db: mean power per sensor over that of the white noise: one for all tones, or one for each.
        correlation: between neighbours; it falls exponentially, by this factor from sensor to sensor.
        surface_share: share of the power that comes from shallow sources all around instead.
        surface: positions of these, in the region's coordinates: each is a ring of independent sources, whose
            modes or paths have random phases.
    """

    KEY: ClassVar[str] = "scenario.disturbances.noise_colour"

    level_db: list[Decibels] = field(default_factory=lambda: [0.0])
    correlation: Annotated[float, Range("a number from 0, below 1", 0, 1, open_high=True)] = 0.0
    surface_share: Share = 0.0
    surface: list[Annotated[Any, Each(FINITE)]] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        known = self.surface_share == 0 or len(self.surface) > 0
        require(known, f"{self.KEY}.surface", self.surface, "positions of the share from the surface")


@dataclass
class GainJumpSettings(Checked):
    """Steps in which all sensors have another gain.

    Attributes:
        first: of the steps.
        last: of the steps (null: stays to the end).
        factor: of the amplitude.
    """

    KEY: ClassVar[str] = "scenario.disturbances.gain_jumps"

    first: StepIndex = 0
    last: StepIndex | None = None
    factor: Factor = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        rising = self.last is None or self.last >= self.first
        require(rising, f"{self.KEY}.last", self.last, f"a step from first, {self.first}, up, or null")


@dataclass
class DisturbanceSettings(Checked):
    """Disturbances of the simulated snapshots, unknown to the tracker; none by default.

    Attributes:
        noise_colour: correlated noise beside the white one; None is none.
        offset: magnitude of a constant added to every snapshot, over the standard deviation of the white
            noise; its phase is drawn for each tone and sensor.
        sensor_factors: factors of the amplitudes of single sensors, by their indices.
        gain_jumps: of all sensors.
        impulse_share: share of the samples, of any step, tone, snapshot and sensor, that are impulses.
        impulse_factor: of their amplitude.
    """

    KEY: ClassVar[str] = "scenario.disturbances"

    noise_colour: NoiseColourSettings | None = None
    offset: Factor = 0.0
    sensor_factors: dict[int, Factor] = field(default_factory=dict)
    gain_jumps: list[GainJumpSettings] = field(default_factory=list)
    impulse_share: Share = 0.0
    impulse_factor: Factor = 1.0


def disturb(
    snapshots: Tensor,
    disturbances: DisturbanceSettings,
    response: Field,
    noise_variance: float,
    generator: Generator,
) -> Tensor:
    """Disturb the snapshots of one sequence: what is added, then the gains, then impulses.

    Args:
        snapshots: `(K, I, J, M)` complex128.
        disturbances: which, and how much.
        response: field in float64, for noise from the surface.
        noise_variance: of the white noise, per sensor.
        generator: random numbers.

    Returns:
        `(K, I, J, M)`; the very snapshots where there is no disturbance.

    Raises:
        InputError: where tones, sensors or positions do not fit the field.
    """
    if disturbances.noise_colour is not None:
        covariance = noise_variance * noise_covariance(disturbances.noise_colour, response)
        snapshots = snapshots + coloured_noise(covariance, snapshots.shape, generator)
    if disturbances.offset:
        snapshots = add_offset(snapshots, disturbances.offset * noise_variance**0.5, generator)
    snapshots = scale_sensors(snapshots, disturbances.sensor_factors)
    for jump in disturbances.gain_jumps:
        snapshots = scale_steps(snapshots, jump)
    if disturbances.impulse_share:
        share, factor = disturbances.impulse_share, disturbances.impulse_factor
        snapshots = add_impulses(snapshots, share, factor, generator)
    return snapshots


def noise_covariance(colour: NoiseColourSettings, response: Field) -> Tensor:
    """Covariance of coloured noise over the variance of the white one, `(I, M, M)` complex128.

    Raises:
        InputError: where levels or positions do not fit the field, or it knows no random phases.
    """
    tones, sensors = response.num_tones, response.num_sensors
    level = torch.tensor(colour.level_db, dtype=torch.float64)
    expected = f"one number, or one for each of {tones} tones"
    require(len(level) in (1, tones), f"{colour.KEY}.level_db", colour.level_db, expected)
    index = torch.arange(sensors, dtype=torch.float64)
    along = (colour.correlation ** (index[:, None] - index).abs()).to(torch.complex128)
    shape = along.expand(tones, -1, -1)
    if colour.surface_share:
        shape = torch.lerp(shape, _from_surface(colour, response), colour.surface_share)
    return (10 ** (level / 10))[:, None, None] * shape


def _from_surface(colour: NoiseColourSettings, response: Field) -> Tensor:
    """Mean over all rings, of trace M."""
    key, width = f"{colour.KEY}.surface", response.num_coordinates
    fits = all(len(position) == width for position in colour.surface)
    require(fits, key, colour.surface, f"{width} coordinates each, as the field")
    found = as_field(response).incoherent(torch.tensor(colour.surface, dtype=torch.float64))
    expected = "none: this field knows no paths of random phases"
    require(found is not None, key, colour.surface, expected)
    assert found is not None
    covariance = found.mean(0)
    trace = covariance.diagonal(dim1=-2, dim2=-1).real.sum(-1)
    return covariance * (response.num_sensors / trace)[:, None, None]


def coloured_noise(covariance: Tensor, shape: tuple[int, ...], generator: Generator) -> Tensor:
    """Circular complex normal noise `(K, I, J, M)` of covariances `(I, M, M)`, which may be singular."""
    power, vectors = torch.linalg.eigh(covariance)
    root = vectors * power.clamp(min=0).sqrt()[..., None, :]
    white = torch.randn(shape, generator=generator, dtype=torch.complex128)
    return white @ root.mT


def add_offset(snapshots: Tensor, magnitude: float, generator: Generator) -> Tensor:
    """Add one constant of this magnitude and random phase for each tone and sensor."""
    num_tones, _, num_sensors = snapshots.shape[1:]
    turn = torch.rand(num_tones, 1, num_sensors, generator=generator, dtype=torch.float64)
    return snapshots + torch.polar(torch.full_like(turn, magnitude), 2 * torch.pi * turn)


def scale_sensors(snapshots: Tensor, factors: dict[int, float]) -> Tensor:
    """Give single sensors another gain.

    Raises:
        InputError: naming sensors that are not there.
    """
    num_sensors = snapshots.shape[-1]
    known = all(0 <= sensor < num_sensors for sensor in factors)
    key = f"{DisturbanceSettings.KEY}.sensor_factors"
    require(known, key, sorted(factors), f"sensors from 0 to {num_sensors - 1}")
    gain = torch.ones(num_sensors, dtype=torch.float64)
    for sensor, factor in factors.items():
        gain[sensor] = factor
    return snapshots * gain if factors else snapshots


def scale_steps(snapshots: Tensor, jump: GainJumpSettings) -> Tensor:
    """Give all sensors another gain for some steps."""
    step = torch.arange(len(snapshots))
    inside = (step >= jump.first) & (step <= (len(step) if jump.last is None else jump.last))
    gain = torch.where(inside, jump.factor, 1.0).double()
    return snapshots * gain[:, None, None, None]


def add_impulses(snapshots: Tensor, share: float, factor: float, generator: Generator) -> Tensor:
    """Multiply samples drawn independently with this probability."""
    hit = torch.rand(snapshots.shape, generator=generator, dtype=torch.float64) < share
    return torch.where(hit, factor * snapshots, snapshots)
