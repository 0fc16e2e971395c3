"""Spherical waves of objects near an array."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.field.array import SensorArray

MIN_DISTANCE = 1e-3


class SphericalWaveField(SensorArray):
    """Response of an array to a point source, `a_m = exp(-sign i 2 pi f / c R_m) / R_m`, `R_m = |x - p_m|`.

    The free field of a point source (Jensen, Kuperman, Porter and Schmidt, Computational Ocean Acoustics, 2nd
    ed. 2011, ch. 2.3), in units of its amplitude at 1 m. A sensor nearer to the object hears the wave earlier
    and, with `sign` +1, is ahead in phase. Far away and with unit norm it is `PlaneWaveField` of the same
    sign but for a common phase. Distances below `MIN_DISTANCE` count as that, with derivative zero.

    The state is a position in metres on the axes of the sensors, then its rates. Sensors in a plane (for two
    coordinates, a vertical one: on a line as seen from above) hear the same from both sides of it: a tracker
    refuses a region that holds both.

    Args:
        freqs: `(I,)` tones, Hz.
        sensor_positions: `(M, 3)` m.
        wave_speed: m/s.
        num_coordinates: 2 for objects (x, y) in a horizontal plane, 3 for (x, y, z).
        plane_z: height of that plane, m; without a meaning for three coordinates.
        normalize: give each tone's response unit norm over the sensors.
        sign: +1 for spectra whose time factor is `exp(i omega t)`, as of an FFT: the sensor nearest to the
            object is ahead in phase. -1 for their conjugates.
        device: of the buffers, and so of the states.
        dtype: real type of the states.

    Raises:
        InputError: naming the key of the field at fault; also where the sensors span too few dimensions to
            tell the states of one side apart: one horizontal dimension for two coordinates, two for three.
    """

    def __init__(
        self,
        freqs: Sequence[float],
        sensor_positions: Sequence[Sequence[float]],
        wave_speed: float,
        *,
        num_coordinates: int = 2,
        plane_z: float = 0.0,
        normalize: bool = True,
        sign: int = 1,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        require(num_coordinates in (2, 3), "field.num_coordinates", num_coordinates, "2 or 3")
        holds = isinstance(plane_z, int | float) and math.isfinite(plane_z)
        require(holds, "field.plane_z", plane_z, "a finite number, m")
        self.num_coordinates, space = num_coordinates, num_coordinates
        super().__init__(freqs, sensor_positions, wave_speed, space, space - 1, sign, device, dtype)
        self.plane_z, self.normalize = plane_z, normalize

    def forward(self, state: Tensor) -> Tensor:
        """Evaluate the response.

        Args:
            state: `(*batch, D)` real, `D >= num_coordinates`.

        Returns:
            `(*batch, I, M)` complex.

        Raises:
            ValueError: if `state` has too few entries or another type than the field.
        """
        position = self._in_space(state)
        square = (position[..., None, :] - self._places).square().sum(-1)
        distance = square.clamp(min=MIN_DISTANCE**2).sqrt()
        loss = 1 / distance
        if self.normalize:
            loss = loss / torch.linalg.vector_norm(loss, dim=-1, keepdim=True)
        return loss.to(state.dtype)[..., None, :] * self.waves(-distance)

    def images(self, state: Tensor) -> Tensor:
        """Positions of equal responses, across the sensors' line or plane."""
        across = self.mirrored(self._in_space(state) - self._middle) + self._middle
        return across[..., : self.num_coordinates].to(state.dtype)

    def _in_space(self, state: Tensor) -> Tensor:
        """`(*batch, 3)` m, float64."""
        position = self.position(state)
        if self.num_coordinates == 3:
            return position
        return torch.cat([position, torch.full_like(position[..., :1], self.plane_z)], -1)
