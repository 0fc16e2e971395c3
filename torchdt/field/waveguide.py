"""Field of a point source in a layered waveguide on a vertical array, as a sum of normal modes."""

import math
from collections.abc import Callable, Sequence
from typing import Self

import torch
from torch import Tensor, nn
from torch.nn import functional

from torchdt.field.environment import Environment
from torchdt.field.modes import ModeTable, solve_modes

MIN_RANGE = 1.0
MIN_DEPTH = 0.01
# States evaluated at a time: keeps the work space of a chunk in the processor's cache.
_CHUNK = 1024
# Smallest squared norm to divide by: far below that of any real field, and its power -3/2 is still finite.
_MIN_POWER = 1e-20


class NormalModeField(nn.Module):
    """Response of a vertical array, `p_m = sum_n psi_n(z_s) psi_n(z_m) exp(-i k_n r_m) / sqrt(kr_n r)`.

    Here `k_n = kr_n - i alpha_n`: the far field of Jensen, Kuperman, Porter and Schmidt, Computational Ocean
    Acoustics, 2nd ed. 2011, ch. 5, for a time factor `exp(i omega t)` and up to a constant factor. The array
    leans towards the source by the tilt `t`, so that `r_m = r - (z_ref - z_m) tan t` with `z_ref` the deepest
    sensor. A mode's phase is taken in float64 whatever the type of the state, because thousands of radians
    leave float32 too few digits.

    The state is range m, depth m, and what else the caller keeps there. Ranges below `MIN_RANGE` and depths
    outside the water count as the nearest one inside, with derivative zero: values and gradients stay finite,
    and it is for the caller to give such states no weight.

    Args:
        environment: the waveguide.
        freqs: `(I,)` tones, Hz.
        sensor_depths: `(M,)` depths of the sensors, m, in the water.
        tilt: degrees. A number is folded into the receivers once; a tensor (say, a parameter to be learnt) at
            every call, and the response is differentiable in it.
        normalize: give each tone's response unit norm over the sensors.
        max_phase_speed: modes of a higher phase speed are left out, m/s, see `solve_modes`.
        device: of the buffers, and so of the states.
        dtype: real type of the buffers, and so of the states.

    Raises:
        ValueError: if `freqs` or `sensor_depths` is empty, or a sensor is outside the water.
        ModeSolverError: if the modes cannot be computed.
    """

    num_coordinates = 2
    _shapes: Tensor  # (2 G, N): rows alternate between mode functions and their slopes times the grid step
    _loss: Tensor  # (N,) attenuation, Np/m
    _cycles: Tensor  # (N,) wavenumber / 2 pi, float64
    _receivers: Tensor  # (N, M) mode functions at the sensors over sqrt(kr), float64
    _offsets: Tensor  # (M,) heights above the deepest sensor, m, float64
    _folded: Tensor  # (N, M) complex receivers of the tilted array

    def __init__(
        self,
        environment: Environment,
        freqs: Sequence[float],
        sensor_depths: Sequence[float],
        tilt: float | Tensor = 0.0,
        *,
        normalize: bool = True,
        max_phase_speed: float = 1750.0,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        bottom = environment.water_depth
        if len(freqs) == 0:
            raise ValueError("freqs is empty; expected one frequency or more")
        if len(sensor_depths) == 0 or min(sensor_depths) <= 0 or max(sensor_depths) > bottom:
            raise ValueError(
                f"sensor_depths is {tuple(sensor_depths)}; expected one or more depths in (0, {bottom}]"
            )
        self.num_tones = len(freqs)
        self.num_sensors = len(sensor_depths)
        self.normalize = normalize
        self.water_depth = bottom
        self.tilt = tilt

        tables = [solve_modes(environment, float(f), max_phase_speed) for f in freqs]
        self._num_modes = [len(table.wavenumber) for table in tables]
        self._num_cells = len(tables[0].depth) - 1
        wavenumber = torch.cat([torch.tensor(table.wavenumber) for table in tables])
        loss = torch.cat([torch.tensor(table.attenuation) for table in tables])
        depths = torch.tensor(list(sensor_depths), dtype=torch.float64)
        shapes = torch.cat([_interleave(table) for table in tables], dim=1)
        receivers = self._interpolate(shapes, depths) / wavenumber.sqrt()
        real = dtype or torch.get_default_dtype()
        for name, value, kind in (
            ("_shapes", shapes, real),
            ("_loss", loss, real),
            ("_cycles", wavenumber / (2 * math.pi), torch.float64),
            ("_receivers", receivers.T.contiguous(), torch.float64),
            ("_offsets", depths.max() - depths, torch.float64),
        ):
            self.register_buffer(name, value.to(device, kind), persistent=False)
        ...
