"""Sensors and tones of an array anywhere in space: checks, and their float64 buffers."""

import logging
import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Self

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from torchdt.core.errors import InputError, require
from torchdt.field.base import BaseField

FLAT = 1e-3
"""Extent of an array across a line or plane, relative to that along it, up to which it counts as flat."""

log = logging.getLogger(__name__)


class SensorArray(nn.Module, BaseField):
    """What fields of free space share: places, wavenumbers, and phases that float32 can hold.

    A later arrival has the smaller phase: the time factor of the spectra is `exp(+i omega t)`, as of a
    Fourier transform. Phases are taken in float64 whatever the type of the state: at thousands of radians
    float32 leaves too few digits.

    Sensors on a line, or in a plane, hear the same from both sides of it. What the states are on the other
    side is up to the subclass (`images`), which finds the normal of that line or plane in `_normal`.

    Args:
        freqs: `(I,)` tones, Hz.
        sensor_positions: `(M, 3)` m; the axes are those of the states (east, north, up for directions).
        wave_speed: m/s.
        space: 2 where states lie in a horizontal plane, so that heights of the sensors do not tell one side
            from the other, 3 elsewhere.
        min_rank: number of the dimensions of `space` that the sensors must span, or states could not be told
            apart even on one side.
        sign: +1 for spectra of a Fourier transform, -1 for their conjugates.
        device: of the buffers, and so of the states.
        dtype: real type of the states.

    Raises:
        InputError: naming the key of the field at fault.
    """

    num_coordinates: int
    _places: Tensor  # (M, 3) m, float64
    _cycles: Tensor  # (I,) wavenumbers / 2 pi, 1/m, float64
    _middle: Tensor  # (3,) m, mean place of the sensors, float64
    _normal: Tensor | None  # (3,) of the line or plane that all sensors lie in, float64; None: there is none

    def __init__(
        self,
        freqs: Sequence[float],
        sensor_positions: Sequence[Sequence[float]],
        wave_speed: float,
        space: int,
        min_rank: int,
        sign: int = 1,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        tones, places = (
            as_numbers("field.freqs", freqs),
            as_numbers("field.sensor_positions", sensor_positions),
        )
        holds = tones.ndim == 1 and len(tones) > 0 and bool((tones > 0).all())
        require(holds, "field.freqs", freqs, "one positive frequency or more, Hz")
        holds = places.ndim == 2 and places.shape[-1] == 3 and len(places) > 0
        found = f"shape {tuple(places.shape)}"
        require(holds, "field.sensor_positions", found, "(M, 3): east, north and up of each sensor, m")
        middle = places.mean(0)
        centred = (places - middle)[:, :space]
        square, axes = torch.linalg.eigh(centred.T @ centred)
        rank = int((square > FLAT**2 * square[-1]).sum())
        expected = f"{min_rank} or more, to tell states of this many coordinates apart"
        where = "dimensions" if space == 3 else "horizontal dimensions"
        found = f"sensors that span {rank} {where}"
        require(rank >= min_rank, "field.sensor_positions", found, expected)
        holds = isinstance(wave_speed, int | float) and 0 < wave_speed < math.inf
        require(holds, "field.wave_speed", wave_speed, "a positive number, m/s")
        require_sign(sign)
        self.num_tones, self.num_sensors = len(tones), len(places)
        self.dtype, self.sign = dtype or torch.get_default_dtype(), sign
        normal = None if rank == space else pad(axes[:, 0], (0, 3 - space)).to(device)
        self.register_buffer("_places", places.to(device), persistent=False)
        self.register_buffer("_middle", middle.to(device), persistent=False)
        self.register_buffer("_normal", normal, persistent=False)
        self.register_buffer("_cycles", (sign * tones / wave_speed).to(device), persistent=False)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        # A change of type, as by `module.float()`, must not reach what is float64 on purpose.
        return super()._apply(lambda buffer: buffer.to(fn(buffer).device), recurse)

    def waves(self, path: Tensor) -> Tensor:
        """`exp(sign i 2 pi f / c path)` of paths `(*batch, M)` m in float64, `(*batch, I, M)` complex.

        A path is by how much less a wave has travelled to a sensor: what hears it first has the largest.
        """
        phase = 2 * math.pi * (path[..., None, :] * self._cycles[:, None]).frac().to(self.dtype)
        return torch.complex(phase.cos(), phase.sin())

    def incoherent(self, state: Tensor) -> Tensor:
        """A diffuse sound field of the response's energy: waves from everywhere, none coherent with another.

        `R_pq = |a|^2 / M sin(k d_pq) / (k d_pq)`, `d_pq` the distance of two sensors, is the mean of `a a^H`
        over plane waves from all directions of space (Cook et al., J. Acoust. Soc. Am. 27, 1955): what a room
        makes of a source.

        Args:
            state: `(*batch, D)` real, as the field takes it.

        Returns:
            `(*batch, I, M, M)` complex Hermitian, of trace `|a|^2`.
        """
        response = self(state)
        distance = torch.cdist(self._places, self._places)
        coherence = torch.sinc(2 * self._cycles[:, None, None] * distance).to(response.dtype)
        energy = response.abs().square().sum(-1) / self.num_sensors
        return energy[..., None, None] * coherence

    def position(self, state: Tensor) -> Tensor:
        """The position part of a state, float64.

        Raises:
            ValueError: if the state has too few entries or another type than the field.
        """
        d = self.num_coordinates
        if state.ndim == 0 or state.shape[-1] < d or state.dtype != self.dtype:
            raise ValueError(
                f"state has shape {tuple(state.shape)} and type {state.dtype}; "
                f"expected (*batch, {d} or more) of {self.dtype}"
            )
        return state[..., :d].double()

    def mirrored(self, vector: Tensor) -> Tensor:
        """Vectors `(n, *batch, 3)` on the other side of the sensors' line or plane; n is 0 or 1."""
        if self._normal is None:
            return vector.new_empty(0, *vector.shape)
        across = (vector @ self._normal)[..., None] * self._normal
        return (vector - 2 * across)[None]


def as_numbers(key: str, values: Sequence[float] | Sequence[Sequence[float]]) -> Tensor:
    """A setting as a float64 tensor on the CPU.

    Raises:
        InputError: where it is no array of finite numbers.
    """
    try:
        tensor = torch.as_tensor(values, dtype=torch.float64, device="cpu")
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError.of_key(key, values, f"an array of numbers ({error})") from error
    require(bool(tensor.isfinite().all()), key, values, "finite numbers")
    return tensor


def require_sign(sign: object) -> None:
    """Refuse what is no sign of phases."""
    require(sign in (1, -1), "field.sign", sign, "1 or -1")


def nearest_spacing(places: Tensor) -> float:
    """Smallest distance between two of the sensors `(M, 3)`, in their unit; infinite for a single one."""
    return min(torch.pdist(places).tolist(), default=math.inf)


def warn_of_aliasing(places: Tensor, freqs: Sequence[float], wave_speed: float) -> None:
    """Warn in the log where even neighbouring sensors are more than half a wavelength apart.

    A regular array then takes some directions for others (grating lobes); an irregular one has high side
    lobes instead.

    Args:
        places: `(M, 3)` m.
        freqs: `(I,)` Hz.
        wave_speed: m/s.
    """
    spacing, half = nearest_spacing(places), wave_speed / max(freqs) / 2
    if math.isfinite(spacing) and spacing > half * (1 + 1e-6):
        _warn(f"{spacing:.4g}", f"{half:.4g}", f"{max(freqs):.4g}")


@cache
def _warn(spacing: str, half: str, tone: str) -> None:
    """Once for each array, which a run may build several times."""
    log.warning(
        "nearest sensors are %s m apart, more than half the wavelength of the highest tone, %s m at %s Hz: "
        "directions may be ambiguous",
        spacing,
        half,
        tone,
    )
