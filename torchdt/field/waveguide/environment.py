"""A horizontally layered ocean: water column, sediment layers and a half-space below."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Self

import numpy as np

Knots = tuple[tuple[float, float], ...]

ATTENUATION_UNITS = ("dB/(km Hz)", "dB/(m kHz)", "dB/wavelength")
"""The first two are the same; one of the last is `1000 / c` of them where the speed is c m/s."""


@dataclass(frozen=True)
class Layer:
    """A fluid sediment layer whose sound speed is linear in depth.

    Attributes:
        bottom: depth of its lower boundary, m; its upper one is where the layer above ends.
        speed_top: sound speed at the upper boundary, m/s.
        speed_bottom: sound speed at the lower boundary, m/s.
        density: g/cm^3, water being 1.
        attenuation: in its unit.
        attenuation_unit: one of `ATTENUATION_UNITS`; the wavelength is that at each depth.

    Raises:
        ValueError: if a figure is not finite, or not positive (attenuation: negative), or the unit unknown.
    """

    bottom: float
    speed_top: float
    speed_bottom: float
    density: float
    attenuation: float
    attenuation_unit: str = ATTENUATION_UNITS[0]

    def __post_init__(self) -> None:
        for name in ("bottom", "speed_top", "speed_bottom", "density"):
            _check_positive(name, getattr(self, name))
        _check_attenuation(self.attenuation, self.attenuation_unit)


@dataclass(frozen=True)
class HalfSpace:
    """The uniform fluid below all layers.

    Attributes:
        speed: sound speed, m/s.
        density: g/cm^3, water being 1.
        attenuation: in its unit.
        attenuation_unit: one of `ATTENUATION_UNITS`.

    Raises:
        ValueError: if a figure is not finite, or not positive (attenuation: negative), or the unit unknown.
    """

    speed: float
    density: float
    attenuation: float
    attenuation_unit: str = ATTENUATION_UNITS[0]

    def __post_init__(self) -> None:
        _check_positive("speed", self.speed)
        _check_positive("density", self.density)
        _check_attenuation(self.attenuation, self.attenuation_unit)


@dataclass(frozen=True)
class Environment:
    """A range-independent waveguide, hashable so that its modes can be cached.

    The water has density 1 g/cm^3 and absorbs nothing.

    Attributes:
        profile: knots (depth m, sound speed m/s) of the water, piecewise linear, from the surface (depth 0)
            to the seafloor (the last knot). Any sequence of pairs is accepted and kept as tuples of floats.
        layers: sediment layers, uppermost first; may be empty.
        halfspace: what lies below the last layer.

    Raises:
        ValueError: if the profile does not start at depth 0, depths do not increase, or a speed is not
            positive.
    """

    profile: Knots
    layers: tuple[Layer, ...]
    halfspace: HalfSpace

    def __post_init__(self) -> None:
        object.__setattr__(self, "profile", _as_knots("profile", self.profile))
        object.__setattr__(self, "layers", tuple(self.layers))
        if len(self.profile) < 2 or self.profile[0][0] != 0.0:
            raise ValueError(
                f"profile is {self.profile}; expected two or more knots, the first of them at depth 0"
            )
        for _, speed in self.profile:
            _check_positive("speed in profile", speed)
        bottoms = [self.water_depth, *(layer.bottom for layer in self.layers)]
        if any(lower <= upper for upper, lower in pairwise(bottoms)):
            raise ValueError(
                f"layers end at depths {bottoms[1:]}; expected increasing depths below {bottoms[0]}"
            )

    @property
    def water_depth(self) -> float:
        """Depth of the seafloor, m."""
        return self.profile[-1][0]

    def perturbed(self, water_depth: float | None = None, delta_c: Sequence[Sequence[float]] = ()) -> Self:
        """Copy with another water depth and a changed sound-speed profile.

        Args:
            water_depth: new depth of the seafloor, m; all layers move with it. The profile is cut there, or
                extended by the speed of its last knot.
            delta_c: knots (depth m, change of sound speed m/s), piecewise linear, constant above the first
                and below the last; see `combine_eofs`. Its depths become knots of the profile too, so that
                nothing of it is lost between the knots of this one.

        Raises:
            ValueError: if `water_depth` is not positive, depths of `delta_c` do not increase, or a resulting
                speed is not positive.
        """
        depth = self.water_depth if water_depth is None else float(water_depth)
        _check_positive("water_depth", depth)
        z, c = np.array(self.profile).T
        knots = np.append(z[z < depth], depth)
        if len(delta_c):
            dz, dc = np.array(_as_knots("delta_c", delta_c)).T
            knots = np.union1d(knots, dz[(dz > 0) & (dz < depth)])
            speeds = np.interp(knots, z, c) + np.interp(knots, dz, dc)
        else:
            speeds = np.interp(knots, z, c)
        shift = depth - self.water_depth
        return replace(
            self,
            profile=tuple(zip(knots.tolist(), speeds.tolist(), strict=True)),
            layers=tuple(replace(layer, bottom=layer.bottom + shift) for layer in self.layers),
        )


def combine_eofs(
    depths: Sequence[float], eofs: Sequence[Sequence[float]], coefficients: Sequence[float]
) -> Knots:
    """Sound-speed change `sum_i c_i EOF_i(z)` as knots for `Environment.perturbed`.

    Args:
        depths: `(Z,)` depths of the table, m, increasing.
        eofs: `(Z, E)` empirical orthogonal functions, one per column, m/s.
        coefficients: `(E,)` coefficients, or fewer for the leading functions only.

    Raises:
        ValueError: if the shapes do not fit.
    """
    table = np.asarray(eofs, dtype=float)
    if table.ndim != 2 or len(table) != len(depths) or table.shape[1] < len(coefficients):
        raise ValueError(
            f"eofs has shape {table.shape}; expected {len(depths)} rows, {len(coefficients)} columns or more"
        )
    delta = table[:, : len(coefficients)] @ np.asarray(coefficients, dtype=float)
    return _as_knots("depths", list(zip(depths, delta.tolist(), strict=True)))


def _as_knots(name: str, pairs: Sequence[Sequence[float]]) -> Knots:
    knots = tuple((float(z), float(value)) for z, value in pairs)
    if not all(math.isfinite(number) for knot in knots for number in knot):
        raise ValueError(f"{name} is {knots}; expected finite numbers")
    if any(lower[0] <= upper[0] for upper, lower in pairwise(knots)):
        raise ValueError(f"{name} has depths {[z for z, _ in knots]}; expected increasing ones")
    return knots


def _check_positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} is {value}; expected a positive number")


def _check_attenuation(value: float, unit: str) -> None:
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"attenuation is {value}; expected a number not below zero")
    if unit not in ATTENUATION_UNITS:
        raise ValueError(f"attenuation_unit is {unit!r}; expected one of {ATTENUATION_UNITS}")
