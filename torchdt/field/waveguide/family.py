"""Waveguides beside the nominal one: sound speed, bottom, and the array's shape and sensors as parameters.

A mode solver is not differentiable, but wavenumbers and mode functions are smooth in the environment.
Central differences at one environment give a field that is exact there, right to first order around it,
and differentiable in the parameters.
"""

import functools
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torchdt.core.support import REAL, Quantity
from torchdt.field.base import BaseField
from torchdt.field.build import EnvironmentDraw
from torchdt.field.uneven import UnevenArrayField, sensor_gains
from torchdt.field.waveguide.linearised import Departure, LinearisedModes, Sides
from torchdt.field.waveguide.sloped import SlopedField
from torchdt.field.waveguide.waveguide import NormalModeField

ENVIRONMENT = {
    "eof_coefficients": Quantity(REAL, vector=True),
    "tilt_deg": Quantity(REAL),
    "water_depth_m": Quantity(REAL),
}
"""What a likelihood can be differentiated in: changes of the environment from the nominal one."""

GROUPS = {
    "sound speed, tilt and depth": ("eof_coefficients", "tilt_deg", "water_depth_m"),
    "bow": ("bow_m",),
    "slope": ("slope_m_per_km",),
    "sensors": ("gain_db", "phase_deg"),
}
"""Parameters of a family that leave their nominal values together or not at all."""

WORDS = {
    "eof_coefficients": "EOF{}",
    "tilt_deg": "tilt (deg)",
    "water_depth_m": "water depth (m)",
    "bow_m": "bow (m)",
    "slope_m_per_km": "slope (m/km)",
    "gain_db": "sensor gains (dB)",
    "phase_deg": "sensor phases (deg)",
}
"""What these are called for people."""

SCALARS = ("water_depth_m", "tilt_deg", "bow_m", "slope_m_per_km")

_SMALL_SLOPE = 1e-6
"""Slope in m/km that stands for a flat bottom which may begin to slope."""
_GENTLE = 0.5
"""Slope in m/km that is not known well enough from the depths it passes through."""


_REMEMBERED = 32
"""Fields kept, since fits of other groups of parameters begin at the same ones."""


class WaveguideFamily:
    """Fields by parameters theta, which lie one behind another in the order of `WaveguideFamily.parts`.

    A parameter of prior standard deviation zero is left out of theta and stays at its nominal value.

    Args:
        solve: makes the normal-mode field of a departure from the nominal environment.
        eof_std: prior standard deviations of the EOF coefficients.
        tilt_std_deg: of the tilt, degrees.
        water_depth_std_m: of the water depth, m.
        device: of the parameters.
        bow_std_m: of the bow of the array, m.
        slope_std_m_per_km: of the rise of the bottom away from the array, m/km.
        gain_std_db: of the gain of each of the sensors, dB; all zero for none.
        phase_std_deg: of the phase of each of the sensors, degrees; all zero for none.

    Attributes:
        prior_std: `(T,)` float64.
        water_depth: nominal, at the array, m.
        parts: where in theta each of `eof_coefficients`, `tilt_deg`, `water_depth_m`, `bow_m`,
            `slope_m_per_km`, `gain_db` and `phase_deg` is.
    """

    def __init__(
        self,
        solve: Callable[[EnvironmentDraw], NormalModeField],
        eof_std: Sequence[float],
        tilt_std_deg: float,
        water_depth_std_m: float,
        device: torch.device | str = "cpu",
        *,
        bow_std_m: float = 0.0,
        slope_std_m_per_km: float = 0.0,
        gain_std_db: Sequence[float] = (),
        phase_std_deg: Sequence[float] = (),
    ):
        self._solve = functools.lru_cache(maxsize=_REMEMBERED)(solve)
        stds = {
            "eof_coefficients": eof_std,
            "tilt_deg": [tilt_std_deg],
            "water_depth_m": [water_depth_std_m],
            "bow_m": [bow_std_m],
            "slope_m_per_km": [slope_std_m_per_km],
            "gain_db": gain_std_db,
            "phase_deg": phase_std_deg,
        }
        self.parts, flat = dict[str, slice](), list[float]()
        for name, values in stds.items():
            kept = list(values) if any(values) else []
            self.parts[name] = slice(len(flat), len(flat) + len(kept))
            flat += kept
        self.prior_std = torch.tensor(flat, dtype=torch.float64, device=device)
        self.water_depth = float(solve(EnvironmentDraw()).water_depth)

    @property
    def groups(self) -> dict[str, Tensor]:
        """Masks `(T,)` of parameters that belong together, by name; none that is empty."""
        masks = {}
        for group, names in GROUPS.items():
            mask = torch.zeros_like(self.prior_std, dtype=torch.bool)
            for name in names:
                mask[self.parts[name]] = True
            masks[group] = mask
        return {group: mask for group, mask in masks.items() if bool(mask.any())}

    def part(self, theta: Tensor, name: str) -> Tensor:
        """Entries of theta by the name of their parameter, none where it is none."""
        return theta[self.parts[name]]

    def describe(self, theta: Tensor) -> str:
        """What departs from the nominal environment, in words."""
        found = []
        for name, word in WORDS.items():
            values = self.part(theta, name)
            if name in ("gain_db", "phase_deg"):
                spread = float(values.square().mean().sqrt()) if values.any() else 0.0
                found += [f"{word} {spread:.2f} rms"] if spread else []
            elif values.any():
                numbers = [f" {i + 1}" for i in range(len(values))] if name == "eof_coefficients" else [""]
                found += [f"{word.format(n)} {v:+.2f}" for n, v in zip(numbers, values.tolist(), strict=True)]
        return ", ".join(found) or "nothing"

    def draw(self, theta: Tensor) -> EnvironmentDraw:
        """Departure from the nominal environment, without the sensors."""
        eofs = tuple(self.part(theta, "eof_coefficients").tolist())
        return EnvironmentDraw(eofs, **{name: float(self.part(theta, name).sum()) for name in SCALARS})

    def solve(self, theta: Tensor) -> BaseField:
        """Exact field of parameters `(T,)`."""
        return self._through_sensors(self._solve(self.draw(theta)), theta)

    def linearise(self, theta0: Tensor, free: Tensor | None = None) -> Callable[[Tensor], BaseField]:
        """Fields around `theta0`, differentiable in theta.

        Args:
            theta0: `(T,)` float64.
            free: `(T,)` bool, which of theta may change; None is all.

        Returns:
            A function from theta to the field: exact in tilt, bow and sensors, else see `LinearisedModes`.
            What is not free stays at that of `theta0`.
        """
        free = torch.ones_like(theta0, dtype=torch.bool) if free is None else free
        draw, deeper = self.draw(theta0), None
        centre = self._solve(draw)
        slope = 1000 * float(centre.slope) if isinstance(centre, SlopedField) else 0.0
        if abs(slope) < _GENTLE and bool(self.part(free, "slope_m_per_km").any()):
            if slope == 0:
                centre = self._solve(draw._replace(slope_m_per_km=draw.slope_m_per_km + _SMALL_SLOPE))
            deeper = self._sides(theta0, self.parts["water_depth_m"].start, slope)
        modal = [j for j in self._modal() if free[j]]
        modes = LinearisedModes(centre, [self._sides(theta0, j, slope) for j in modal], deeper)
        index = torch.tensor(modal, dtype=torch.long, device=theta0.device)

        def field_at(theta: Tensor) -> BaseField:
            change = torch.where(free, theta - theta0, 0.0)
            depth, tilt, bow, slope = (self.part(change, name).sum() for name in SCALARS)
            departure = Departure(change[index], depth, tilt, bow, slope / 1000)
            return self._through_sensors(modes.at(departure), torch.where(free, theta, theta0))

        return field_at

    def _modal(self) -> list[int]:
        """Where in theta the parameters are that change the modes."""
        names = ("eof_coefficients", "water_depth_m")
        return [j for name in names for j in range(self.parts[name].start, self.parts[name].stop)]

    def _sides(self, theta0: Tensor, j: int, slope: float) -> Sides:
        """Fields half a standard deviation to both sides in one parameter, without the slope there is."""
        width = float(self.prior_std[j])
        step = torch.zeros_like(theta0)
        step[j] = 0.5 * width
        draws = [self.draw(theta) for theta in (theta0 + step, theta0 - step)]
        above, below = (self._solve(d._replace(slope_m_per_km=d.slope_m_per_km - slope)) for d in draws)
        return Sides(above, below, width)

    def _through_sensors(self, field: NormalModeField, theta: Tensor) -> BaseField:
        gain, phase = self.part(theta, "gain_db"), self.part(theta, "phase_deg")
        if not (gain.numel() or phase.numel()) or not bool(gain.any() or phase.any() or theta.requires_grad):
            return field
        none = theta.new_zeros(field.num_sensors)
        gains = sensor_gains(gain if gain.numel() else none, phase if phase.numel() else none)
        return UnevenArrayField(field, gains, normalize=field.normalize)
