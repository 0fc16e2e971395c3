"""Fields from plain configuration values: the targets named in `field._target_`.

A target is called with the values of its configuration group and the keywords `dtype` and `device`. A
recording that brings its own `freqs`, `element_depths` or `sensor_positions` replaces the values of the
group by these names.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch

from torchdt.core.errors import InputError, require
from torchdt.field.array import as_numbers, warn_of_aliasing
from torchdt.field.plane_wave import LineArrayField, PlaneWaveField
from torchdt.field.spherical_wave import SphericalWaveField
from torchdt.field.waveguide.configured import configured_environment
from torchdt.field.waveguide.environment import combine_eofs
from torchdt.field.waveguide.modes import ModeSolverError
from torchdt.field.waveguide.sloped import SlopedField
from torchdt.field.waveguide.waveguide import NormalModeField


class EnvironmentDraw(NamedTuple):
    """A departure from the nominal environment.

    Attributes:
        eof_coefficients: of the sound-speed EOFs, standard deviations.
        tilt_deg: added to the array tilt, degrees.
        water_depth_m: added to the water depth, m.
        bow_m: added to the bow of the array, m.
        slope_m_per_km: added to how much the bottom rises away from the array.
    """

    eof_coefficients: tuple[float, ...] = ()
    tilt_deg: float = 0.0
    water_depth_m: float = 0.0
    bow_m: float = 0.0
    slope_m_per_km: float = 0.0


def as_draw(draw: EnvironmentDraw | Mapping[str, Any] | None) -> EnvironmentDraw | None:
    """A departure, also from the values of a configuration, which may leave some out.

    Raises:
        InputError: where a name is unknown, or a value is not finite numbers.
    """
    if draw is None or isinstance(draw, EnvironmentDraw):
        return draw
    names = EnvironmentDraw._fields
    require(isinstance(draw, Mapping), "field.draw", draw, f"some of {names} by name")
    for name, value in draw.items():
        key, vector = f"field.draw.{name}", name == "eof_coefficients"
        require(name in names, key, "an unknown key", f"one of {names}")
        entries = value if vector else [value]
        holds = isinstance(entries, list | tuple) and all(map(_is_finite, entries))
        require(holds, key, value, "a list of finite numbers" if vector else "a finite number")
    return EnvironmentDraw(**{**draw, "eof_coefficients": tuple(draw.get("eof_coefficients", ()))})


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def waveguide(
    *,
    freqs: Sequence[float],
    element_depths: Sequence[float],
    profile: Sequence[Sequence[float]] | None = None,
    layers: Sequence[Mapping[str, float]] | None = None,
    halfspace: Mapping[str, float] | None = None,
    attenuation_unit: str | None = None,
    env_file: str | None = None,
    tilt_deg: float = 0.0,
    bow_m: float = 0.0,
    slope_m_per_km: float = 0.0,
    slope_length_m: float = 5000.0,
    normalize: bool = True,
    max_phase_speed: float = 1750.0,
    points_per_wavelength: float = 16.0,
    sign: int = 1,
    eofs: Mapping[str, Any] | None = None,
    draw: EnvironmentDraw | Mapping[str, Any] | None = None,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
) -> NormalModeField:
    """Normal-mode field of a layered waveguide on a vertical array.

    Args:
        freqs: Hz.
        element_depths: m.
        profile: knots (depth m, speed m/s) from the surface to the seafloor.
        layers: keywords of `Layer`, uppermost first, but for the unit.
        halfspace: keywords of `HalfSpace`, but for the unit.
        attenuation_unit: of all attenuations, one of `ATTENUATION_UNITS`; None is dB/(km Hz).
        env_file: path of an environment file, see `read_env`, in place of these four.
        tilt_deg: of the array, degrees, positive towards the source.
        bow_m: how much nearer to the source the middle of the array is than the line through its ends, m.
        slope_m_per_km: how much the bottom rises away from the array; 0 is a flat one.
        slope_length_m: range at which the slope ends, m; the bottom is flat beyond.
        normalize: give each tone's response unit norm.
        max_phase_speed: of the modes kept, m/s.
        points_per_wavelength: of the depth mesh of the mode solver; more where its message asks for more.
        sign: +1 for spectra of a Fourier transform, -1 for their conjugates.
        eofs: sound-speed statistics, `depths` (Z,) m and `functions` (Z, E) m/s; needed for a draw only.
        draw: departure from this environment, or its values by name.
        dtype, device: of the field.

    Raises:
        InputError: where the environment or the array does not make sense, or has no modes.
    """
    draw = as_draw(draw)
    if draw is not None and draw.eof_coefficients:
        require(eofs is not None, "field.eofs", "nothing", "sound-speed EOFs, which field.draw refers to")
    try:
        environment = configured_environment(profile, layers, halfspace, attenuation_unit, env_file)
        if draw is not None:
            delta = (
                combine_eofs(eofs["depths"], eofs["functions"], draw.eof_coefficients)
                if eofs is not None and draw.eof_coefficients
                else ()
            )
            depth = environment.water_depth + draw.water_depth_m
            environment = environment.perturbed(water_depth=depth, delta_c=delta)
            tilt_deg, bow_m = tilt_deg + draw.tilt_deg, bow_m + draw.bow_m
            slope_m_per_km = slope_m_per_km + draw.slope_m_per_km
        kind: Callable[..., NormalModeField] = NormalModeField
        if slope_m_per_km:
            kind = partial(SlopedField, slope=slope_m_per_km / 1000, length=slope_length_m)
        return kind(
            environment,
            freqs,
            element_depths,
            tilt_deg,
            normalize=normalize,
            bow=bow_m,
            max_phase_speed=max_phase_speed,
            points_per_wavelength=points_per_wavelength,
            sign=sign,
            dtype=dtype,
            device=device,
        )
    except InputError:
        raise
    except (ValueError, TypeError, ModeSolverError) as error:
        raise InputError(f"key 'field': {error}") from error


def line_array(
    *,
    freqs: Sequence[float],
    sensor_positions: Sequence[float] | Sequence[Sequence[float]],
    wave_speed: float,
    sign: int = 1,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
) -> LineArrayField:
    """Plane waves on a line array, see `LineArrayField`. Sensors too far apart are warned of in the log.

    Args:
        freqs: Hz.
        sensor_positions: `(M,)` along the line, or `(M, 3)` of which the first coordinate is the line, m.
        wave_speed: m/s.
        sign: +1 for spectra of a Fourier transform, -1 for their conjugates.
        dtype, device: of the field.

    Raises:
        InputError: where the array does not make sense.
    """
    along = as_numbers("field.sensor_positions", sensor_positions)
    if along.ndim == 2:
        on_a_line = bool((along[:, 1:] == along[:1, 1:]).all())
        expected = "sensors along the first coordinate"
        require(on_a_line, "sensor_positions", "sensors off a line", expected)
        along = along[:, 0]
    field = LineArrayField(freqs, along.tolist(), wave_speed, sign=sign, dtype=dtype, device=device)
    warn_of_aliasing(along[:, None], freqs, wave_speed)
    return field


def plane_wave(
    *,
    freqs: Sequence[float],
    sensor_positions: Sequence[Sequence[float]],
    wave_speed: float,
    coordinates: str,
    normalize: bool = True,
    sign: int = 1,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
) -> PlaneWaveField:
    """Plane waves on an array anywhere in space. Sensors too far apart are warned of in the log.

    Args:
        freqs: Hz.
        sensor_positions: `(M, 3)` east, north, up, m.
        wave_speed: m/s.
        coordinates: `direction_cosines`, `azimuth_elevation` or `bearing`, see `PlaneWaveField`.
        normalize: give each tone's response unit norm.
        sign: +1 for spectra of a Fourier transform, -1 for their conjugates.
        dtype, device: of the field.

    Raises:
        InputError: naming the key at fault.
    """
    field = PlaneWaveField(
        freqs,
        sensor_positions,
        wave_speed,
        coordinates,
        normalize=normalize,
        sign=sign,
        device=device,
        dtype=dtype,
    )
    warn_of_aliasing(torch.as_tensor(sensor_positions, dtype=torch.float64, device="cpu"), freqs, wave_speed)
    return field


def spherical_wave(
    *,
    freqs: Sequence[float],
    sensor_positions: Sequence[Sequence[float]],
    wave_speed: float,
    num_coordinates: int = 2,
    plane_z: float = 0.0,
    normalize: bool = True,
    sign: int = 1,
    dtype: torch.dtype | None = None,
    device: torch.device | str | None = None,
) -> SphericalWaveField:
    """Spherical waves of objects near an array. Sensors too far apart are warned of in the log.

    Args:
        freqs: Hz.
        sensor_positions: `(M, 3)` m.
        wave_speed: m/s.
        num_coordinates: 2 for (x, y) in a horizontal plane, 3 for (x, y, z).
        plane_z: height of that plane, m.
        normalize: give each tone's response unit norm.
        sign: +1 for spectra of a Fourier transform, -1 for their conjugates.
        dtype, device: of the field.

    Raises:
        InputError: naming the key at fault.
    """
    field = SphericalWaveField(
        freqs,
        sensor_positions,
        wave_speed,
        num_coordinates=num_coordinates,
        plane_z=plane_z,
        normalize=normalize,
        sign=sign,
        device=device,
        dtype=dtype,
    )
    warn_of_aliasing(torch.as_tensor(sensor_positions, dtype=torch.float64, device="cpu"), freqs, wave_speed)
    return field
