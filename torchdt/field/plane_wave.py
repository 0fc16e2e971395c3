"""Plane waves: on an array anywhere in space, and on a line array."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.field.array import SensorArray, as_numbers
from torchdt.field.directions import DIRECTIONS


class PlaneWaveField(SensorArray):
    """Response of an array to a plane wave, `a_m = exp(sign i 2 pi f / c p_m . u) / sqrt(M)`.

    `p_m` is the place of a sensor and `u` the unit vector towards the object, both east, north, up; see Van
    Trees, Optimum Array Processing, 2002, ch. 2.2. A sensor further towards the object hears the wave earlier
    and, with `sign` +1, is ahead in phase. The state is one of these, then its rates:

    - `direction_cosines`: the parts of u to the east and to the north, for objects above the horizon. States
      outside the unit circle count as the nearest direction on the horizon, so that values and gradients stay
      finite; `inside` says which they are, and a tracker gives them no weight;
    - `azimuth_elevation`: degrees clockwise from north, and degrees above the horizon;
    - `bearing`: degrees clockwise from north, on the horizon. The sensors must not stand on a line, which
      cannot tell one side of it from the other: for a line there is `LineArrayField`.

    Angles go round in a region whose coordinates say so, see `Coordinate.period`. Sensors in a plane hear
    the same from both sides of it, so that a tracker refuses a region that holds both, such as elevations of
    both signs over sensors on level ground.

    Args:
        freqs: `(I,)` tones, Hz.
        sensor_positions: `(M, 3)` east, north, up, m.
        wave_speed: m/s.
        coordinates: what the state is.
        normalize: give the response unit norm; else each sensor has modulus 1.
        sign: +1 for spectra whose time factor is `exp(i omega t)`, as of an FFT: the sensor nearest to the
            object is ahead in phase. -1 for their conjugates.
        device: of the buffers, and so of the states.
        dtype: real type of the states.

    Raises:
        InputError: naming the key of the field at fault; also where the sensors span too few dimensions to
            tell the states apart: two for all, and for a bearing two horizontal ones.
    """

    min_rank = 2

    def __init__(
        self,
        freqs: Sequence[float],
        sensor_positions: Sequence[Sequence[float]],
        wave_speed: float,
        coordinates: str,
        *,
        normalize: bool = True,
        sign: int = 1,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        require(coordinates in DIRECTIONS, "field.coordinates", coordinates, f"one of {list(DIRECTIONS)}")
        self.directions, self.normalize = DIRECTIONS[coordinates], normalize
        self.num_coordinates = self.directions.num_coordinates
        super().__init__(
            freqs, sensor_positions, wave_speed, self.directions.space, self.min_rank, sign, device, dtype
        )

    def forward(self, state: Tensor) -> Tensor:
        """Evaluate the response.

        Args:
            state: `(*batch, D)` real, `D >= num_coordinates`.

        Returns:
            `(*batch, I, M)` complex.

        Raises:
            ValueError: if `state` has too few entries or another type than the field.
        """
        towards = self.directions.vector(self.position(state))
        response = self.waves(towards @ self._places.T)
        return response / math.sqrt(self.num_sensors) if self.normalize else response

    def inside(self, state: Tensor) -> Tensor | None:
        """Which states `(*batch, D)` are directions, `(*batch,)` bool; None: all are."""
        inside = self.directions.inside
        return None if inside is None else inside(state[..., : self.num_coordinates])

    def images(self, state: Tensor) -> Tensor:
        """Positions of equal responses: across the sensors' line or plane, and whole turns away."""
        position, kind = self.position(state), self.directions
        towards = kind.vector(position)
        found = kind.positions(torch.cat([towards[None], self.mirrored(towards)])).flatten(0, 1)
        if kind.turn is not None:
            turns = torch.tensor([-1.0, 0.0, 1.0], dtype=found.dtype, device=found.device) * kind.turn
            shifts = torch.cartesian_prod(*[turns] * self.num_coordinates)
            shifts = shifts.reshape(-1, *[1] * (position.ndim - 1), self.num_coordinates)
            nearest = position + torch.remainder(found - position + kind.turn / 2, kind.turn) - kind.turn / 2
            found = (nearest[:, None] + shifts).flatten(0, 1)
        return found.to(state.dtype)


class LineArrayField(PlaneWaveField):
    """Response of a line array to a plane wave, `a_m = exp(sign i 2 pi f / c x_m sin(bearing)) / sqrt(M)`.

    The state is bearing from broadside, degrees, then its rate, degrees/s. Positive bearings are on the side
    of the line's positive end: a wave from there reaches the sensors of larger `x_m` earlier. It is
    `PlaneWaveField` of sensors to the east. A line hears the same from its two sides, bearings b and 180 - b:
    a tracker refuses a region that holds both, and takes what lies within -90 to 90.

    Args:
        freqs: `(I,)` tones, Hz.
        positions: `(M,)` sensor positions along the line, m.
        wave_speed: m/s.
        sign: +1 for spectra whose time factor is `exp(i omega t)`, as of an FFT: the sensor nearest to the
            object is ahead in phase. -1 for their conjugates.
        device: of the buffers, and so of the states.
        dtype: real type of the buffers, and so of the states.

    Raises:
        InputError: naming the key of the field at fault.
    """

    min_rank = 1

    def __init__(
        self,
        freqs: Sequence[float],
        positions: Sequence[float],
        wave_speed: float = 1500.0,
        *,
        sign: int = 1,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        key = "field.sensor_positions"
        along = as_numbers(key, positions)
        holds, found = along.ndim == 1 and len(along) > 0, f"shape {tuple(along.shape)}"
        require(holds, key, found, "(M,): each sensor's place along the line, m")
        places = [[x, 0.0, 0.0] for x in along.tolist()]
        super().__init__(freqs, places, wave_speed, "bearing", sign=sign, device=device, dtype=dtype)
