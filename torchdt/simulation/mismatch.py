"""How the simulator's environment and array differ from the tracker's; checked once, drawn for each run."""

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import torch
from torch import Generator

from torchdt.core.errors import InputError, require
from torchdt.core.ranges import Checked, Finite, Range, Seed
from torchdt.field.base import BaseField
from torchdt.field.build import EnvironmentDraw
from torchdt.field.uneven import UnevenArrayField, sensor_gains

Magnitude = Annotated[float, Range("a number from 0 up", low=0, most=1e5)]
Spread = Annotated[float, Range("a number from 0 up", low=0, most=360)]


@dataclass
class MismatchSettings(Checked):
    """How the environment and the array of the simulator differ from the tracker's.

    Attributes:
        eof_scale: standard deviations per sound-speed EOF coefficient; 0 keeps the nominal profile.
        tilt_deg: smallest and largest magnitude of the array tilt, degrees; the sign is random.
        water_depth_m: smallest and largest magnitude of the change of water depth, m; random sign.
        bow_m: added to how much nearer to the source the middle of a vertical array is than its ends, m.
        slope_m_per_km: added to how much the bottom rises from the array on, in all directions.
        gain_db: standard deviation of the gains of the sensors, dB, alike for all tones.
        phase_deg: standard deviation of the phases of the sensors, degrees, alike for all tones.
        seed: of the one environment and array that all runs share; None draws each run's from its own seed.
    """

    KEY: ClassVar[str] = "scenario.mismatch"

    eof_scale: Magnitude = 0.0
    tilt_deg: list[Magnitude] = field(default_factory=lambda: [0.0, 0.0])
    water_depth_m: list[Magnitude] = field(default_factory=lambda: [0.0, 0.0])
    bow_m: Finite = 0.0
    slope_m_per_km: Finite = 0.0
    gain_db: Spread = 0.0
    phase_deg: Spread = 0.0
    seed: Seed | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("tilt_deg", "water_depth_m"):
            limits = getattr(self, name)
            holds = len(limits) == 2 and limits[0] <= limits[1]
            require(holds, f"{self.KEY}.{name}", limits, "[smallest, largest], both from 0 up")

    @property
    def matched(self) -> bool:
        """Whether the simulator keeps to the tracker's sound speed, tilt and water depth, which are drawn."""
        return self.eof_scale == 0 and self.tilt_deg[1] == 0 and self.water_depth_m[1] == 0

    def shaped(self, target: dict[str, Any]) -> dict[str, Any]:
        """The configuration of a field, with what differs in all runs alike.

        Raises:
            InputError: where the field has no such thing.
        """
        added = {name: getattr(self, name) for name in ("bow_m", "slope_m_per_km")}
        if not any(added.values()):
            return target
        _require_waveguide(target)
        return target | {name: target.get(name, 0.0) + value for name, value in added.items()}


def draw_environment(
    mismatch: MismatchSettings, target: dict[str, Any], stream: Generator
) -> EnvironmentDraw:
    """One departure from the nominal environment.

    Raises:
        InputError: where the field has no environment to vary.
    """

    def magnitude(limits: list[float]) -> float:
        size, sign = torch.rand(2, generator=stream, dtype=torch.float64).tolist()
        return (limits[0] + (limits[1] - limits[0]) * size) * (1 if sign < 0.5 else -1)

    _require_waveguide(target)
    num = len(target["eofs"]["functions"][0])
    coefficients = mismatch.eof_scale * torch.randn(num, generator=stream, dtype=torch.float64)
    return EnvironmentDraw(
        tuple(coefficients.tolist()), magnitude(mismatch.tilt_deg), magnitude(mismatch.water_depth_m)
    )


def _require_waveguide(target: dict[str, Any]) -> None:
    if target.get("eofs") is None:
        expected = "none: this field has no environment to vary"
        raise InputError.of_key(MismatchSettings.KEY, "a mismatch", expected)


def with_array_errors(response: BaseField, mismatch: MismatchSettings, stream: Generator) -> BaseField:
    """A field with the gains and phases of one run; itself, and nothing drawn, where there are none."""
    if mismatch.gain_db == 0 and mismatch.phase_deg == 0:
        return response
    level, turn = torch.randn(2, response.num_sensors, generator=stream, dtype=torch.float64)
    return UnevenArrayField(response, sensor_gains(mismatch.gain_db * level, mismatch.phase_deg * turn))
