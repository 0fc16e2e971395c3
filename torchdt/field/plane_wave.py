"""Plane waves: on an array anywhere in space, and on a line array."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchdt.errors import require
from torchdt.field.array import SensorArray
from torchdt.field.directions import DIRECTIONS


class PlaneWaveField(SensorArray):
    """Response of an array to a plane wave, `a_m = exp(sign i 2 pi f / c p_m . u) / sqrt(M)`.

    `p_m` is the place of a sensor and `u` the unit vector towards the object, both east, north, up; see Van
    Trees, Optimum Array Processing, 2002, ch. 2.2. The state is one of these, then its rates:

    - `direction_cosines`: the parts of u to the east and to the north, for objects above the horizon. States
      outside the unit circle count as the nearest direction on the horizon, so that values and gradients stay
      finite; `inside` says which they are, and a tracker gives them no weight;
    - `azimuth_elevation`: degrees clockwise from north, and degrees above the horizon;
    - `bearing`: degrees clockwise from north, on the horizon.

    Angles do not wrap: a region is an interval of them.

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
            tell the states apart.
    """

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
        require(sign in (1, -1), "field.sign", sign, "1 or -1")
        self.directions = DIRECTIONS[coordinates]
        self.num_coordinates = self.directions.num_coordinates
        super().__init__(freqs, sensor_positions, wave_speed, self.num_coordinates, device, dtype)
        self.normalize, self.sign = normalize, sign

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
        response = self.waves(self.sign * towards @ self._places.T)
        return response / math.sqrt(self.num_sensors) if self.normalize else response

    def inside(self, state: Tensor) -> Tensor:
        """Which states `(*batch, D)` are directions, `(*batch,)` bool."""
        return self.directions.inside(state[..., : self.num_coordinates])


class LineArrayField(nn.Module):
    """Response of a line array to a plane wave, `a_m = exp(-i 2 pi f / c x_m sin(bearing)) / sqrt(M)`.

    The state is bearing from broadside, degrees, then its rate, degrees/s; only the bearing is read.

    Args:
        freqs: `(I,)` tones, Hz.
        positions: `(M,)` sensor positions along the line, m.
        wave_speed: m/s.
        device: of the buffers, and so of the states.
        dtype: real type of the buffers, and so of the states.

    Raises:
        ValueError: if `freqs` or `positions` is empty, or a tone or the speed is not positive.
    """

    num_coordinates = 1
    _phase_per_sine: Tensor

    def __init__(
        self,
        freqs: Sequence[float],
        positions: Sequence[float],
        wave_speed: float = 1500.0,
        *,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        if len(positions) == 0:
            raise ValueError("positions is empty; expected one position or more")
        if len(freqs) == 0 or min(freqs) <= 0:
            raise ValueError(f"freqs is {tuple(freqs)}; expected one positive frequency or more")
        if wave_speed <= 0:
            raise ValueError(f"wave_speed is {wave_speed}; expected a positive number")
        self.num_tones = len(freqs)
        self.num_sensors = len(positions)
        tones, places = (
            torch.tensor(list(v), dtype=torch.float64, device=device) for v in (freqs, positions)
        )
        phase = (-2 * math.pi / wave_speed * tones)[:, None] * places
        dtype = dtype or torch.get_default_dtype()
        self.register_buffer("_phase_per_sine", phase.to(dtype), persistent=False)

    def forward(self, state: Tensor) -> Tensor:
        """Evaluate the response.

        Args:
            state: `(*batch, D)` real, `D >= 1`.

        Returns:
            `(*batch, I, M)` complex, of unit norm over the sensors.

        Raises:
            ValueError: if `state` has no last axis or another type than the buffers.
        """
        if state.ndim == 0 or state.dtype != self._phase_per_sine.dtype:
            raise ValueError(
                f"state has shape {tuple(state.shape)} and type {state.dtype}; "
                f"expected (*batch, 1 or more) of {self._phase_per_sine.dtype}"
            )
        sine = torch.sin(torch.deg2rad(state[..., 0]))
        phase = sine[..., None, None] * self._phase_per_sine
        return torch.complex(torch.cos(phase), torch.sin(phase)) / math.sqrt(self.num_sensors)
