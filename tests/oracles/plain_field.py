"""Normal modes of a point source on a vertical array in plain NumPy, one tone after another."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from torchdt.field.waveguide.modes import ModeTable


class PlainField:
    """Unit-norm responses (S, I, M) of positions (S, 2), range and depth in metres, in the water.

    `p_m = sum_n psi_n(z_s) psi_n(z_m) exp(-i k_n r_m) / sqrt(kr_n r)`, `k_n = kr_n - i alpha_n`, with
    `r_m = r - (z_ref - z_m) tan t`, where z_ref is the depth of the deepest sensor and t the tilt in degrees.
    """

    def __init__(self, tables: Sequence[ModeTable], sensor_depths: Sequence[float], tilt: float = 0.0):
        sensors = np.array(sensor_depths)
        nearer = math.tan(math.radians(tilt)) * (sensors.max() - sensors)
        self.tones = []
        for table in tables:
            shape = CubicHermiteSpline(table.depth, table.psi, table.slope)
            k = table.wavenumber - 1j * table.attenuation
            receivers = shape(sensors).T * np.exp(1j * k[:, None] * nearer)
            self.tones.append((shape, k, receivers / np.sqrt(table.wavenumber)[:, None]))

    def __call__(self, position: NDArray) -> NDArray:
        distance, depth = position.T
        response = [
            (shape(depth) * np.exp(-1j * k * distance[:, None])) @ receivers
            for shape, k, receivers in self.tones
        ]
        stacked = np.stack(response, 1) / np.sqrt(distance)[:, None, None]
        return stacked / np.linalg.norm(stacked, axis=-1, keepdims=True)
