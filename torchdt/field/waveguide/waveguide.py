"""Field of a point source in a layered waveguide on a vertical array, as a sum of normal modes."""

import math
from collections.abc import Callable, Sequence
from typing import Self

import torch
from torch import Tensor, nn

from torchdt.field.array import require_sign
from torchdt.field.base import BaseField
from torchdt.field.waveguide.environment import Environment
from torchdt.field.waveguide.modes import solve_modes
from torchdt.field.waveguide.shapes import interleave, interpolate_modes

MIN_RANGE = 1.0
MIN_DEPTH = 0.01
# States evaluated at a time: few on a CPU, to keep the work space in its cache, many elsewhere.
_CHUNK_CPU = 2048
_CHUNK_DEVICE = 65536
# Smallest energy and norm to divide by: far below those of any real field.
_MIN_POWER = 1e-20
_MIN_NORM = 1e-10


class NormalModeField(nn.Module, BaseField):
    """Response of a vertical array, `p_m = sum_n psi_n(z_s) psi_n(z_m) exp(-i k_n r_m) / sqrt(kr_n r)`.

    Here `k_n = kr_n - i alpha_n`: the far field of Jensen, Kuperman, Porter and Schmidt, Computational Ocean
    Acoustics, 2nd ed. 2011, ch. 5, for a time factor `exp(i omega t)` and up to a constant factor: what
    arrives later has the smaller phase. With `sign` -1 it is the conjugate. The array leans towards the
    source by the tilt `t`, so that `r_m = r - (z_ref - z_m) tan t` with `z_ref` the deepest sensor, less its
    bow. A mode's phase is taken in float64 whatever the type of the state, because thousands of radians leave
    float32 too few digits.

    The state is range m, depth m, and what else the caller keeps there. Ranges below `MIN_RANGE` and depths
    outside the water count as the nearest one inside, with derivative zero: values and gradients stay finite,
    and it is for the caller to give such states no weight.

    Args:
        environment: the waveguide.
        freqs: `(I,)` tones, Hz.
        sensor_depths: `(M,)` depths of the sensors, m, in the water; one at the surface hears nothing.
        tilt: degrees. A number is folded into the receivers once; a tensor (say, a parameter to be learnt) at
            every call, and the response is differentiable in it.
        normalize: give each tone's response unit norm over the sensors.
        bow: how much nearer to the source the middle of the array is than the line through its ends, m; a
            parabola in depth.
        max_phase_speed: modes of a higher phase speed are left out, m/s, see `solve_modes`.
        points_per_wavelength: of the depth mesh on which the modes are computed, see `solve_modes`.
        sign: +1 for spectra whose time factor is `exp(i omega t)`, as of an FFT; -1 for their conjugates.
        device: of the buffers, and so of the states.
        dtype: real type of the buffers, and so of the states.

    Raises:
        ValueError: if `freqs` or `sensor_depths` is empty, a sensor is outside the water, or a number is not
            finite.
        ModeSolverError: if the modes cannot be computed.
    """

    num_coordinates = 2
    _exact: tuple[str, ...] = ("_cycles", "_receivers", "_heights")  # float64 whatever the type of the field
    _shapes: Tensor  # (2 G, N): rows alternate between mode functions and their slopes times the grid step
    _loss: Tensor  # (N,) attenuation, Np/m
    _cycles: Tensor  # (N,) minus wavenumber / 2 pi, 1/m, float64
    _receivers: Tensor  # (N, M) mode functions at the sensors over sqrt(kr), float64
    _heights: Tensor  # (M,) sensors above the deepest one, m, float64
    _folded: Tensor | None  # (2, N, 2 M) receivers of the tilted array, see `_fold`; None: tilt is a tensor

    def __init__(
        self,
        environment: Environment,
        freqs: Sequence[float],
        sensor_depths: Sequence[float],
        tilt: float | Tensor = 0.0,
        *,
        normalize: bool = True,
        bow: float = 0.0,
        max_phase_speed: float = 1750.0,
        points_per_wavelength: float = 16.0,
        sign: int = 1,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        require_sign(sign)
        bottom = environment.water_depth
        if len(freqs) == 0 or not all(0 < f < math.inf for f in freqs):
            raise ValueError(f"freqs is {tuple(freqs)}; expected one positive frequency or more")
        if not (isinstance(tilt, Tensor) or -90 < tilt < 90):
            raise ValueError(f"tilt is {tilt}; expected degrees between -90 and 90")
        if not math.isfinite(bow):
            raise ValueError(f"bow is {bow}; expected a finite number")
        if not max_phase_speed > 0:
            raise ValueError(f"max_phase_speed is {max_phase_speed}; expected a positive number")
        if len(sensor_depths) == 0 or not all(0 <= z <= bottom for z in sensor_depths):
            raise ValueError(
                f"sensor_depths is {tuple(sensor_depths)}; expected one or more depths in [0, {bottom}]"
            )
        self.num_tones = len(freqs)
        self.num_sensors = len(sensor_depths)
        self.normalize, self.sign = normalize, sign
        self.water_depth: float | Tensor = bottom
        self.tilt: float | Tensor = tilt
        self.bow: float | Tensor = bow

        tables = [solve_modes(environment, float(f), max_phase_speed, points_per_wavelength) for f in freqs]
        self.mode_counts = [len(table.wavenumber) for table in tables]
        wavenumber, loss = (
            torch.cat([torch.tensor(getattr(table, name), device=device) for table in tables])
            for name in ("wavenumber", "attenuation")
        )
        depths = torch.tensor(list(sensor_depths), dtype=torch.float64, device=device)
        shapes = torch.cat([interleave(table, device) for table in tables], dim=1)
        real = dtype or torch.get_default_dtype()
        for name, value, kind in (
            ("_shapes", shapes, real),
            ("_loss", loss, real),
            ("_cycles", -wavenumber / (2 * math.pi), torch.float64),
            ("_receivers", (interpolate_modes(shapes, depths / bottom) / wavenumber.sqrt()).T, torch.float64),
            ("_heights", depths.max() - depths, torch.float64),
        ):
            self.register_buffer(name, value.to(kind), persistent=False)
        folded = None if isinstance(tilt, Tensor) else self._fold()
        self.register_buffer("_folded", folded, persistent=False)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        # A change of type, as by `module.float()`, must not reach what is float64 on purpose.
        exact = {name: getattr(self, name) for name in self._exact}
        super()._apply(fn, recurse)
        for name, value in exact.items():
            setattr(self, name, value.to(self._shapes.device))
        return self

    def forward(self, state: Tensor) -> Tensor:
        """Evaluate the response.

        Args:
            state: `(*batch, D)` real, `D >= 2`: range m, depth m, ...

        Returns:
            `(*batch, I, M)` complex.

        Raises:
            ValueError: if `state` has fewer than two entries or another type than the buffers.
        """
        if state.ndim == 0 or state.shape[-1] < 2 or state.dtype != self._shapes.dtype:
            raise ValueError(
                f"state has shape {tuple(state.shape)} and type {state.dtype}; "
                f"expected (*batch, 2 or more) of {self._shapes.dtype}"
            )
        folded = self._fold() if self._folded is None else self._folded
        receivers = folded.split(self.mode_counts, 1)
        size = _CHUNK_CPU if state.device.type == "cpu" else _CHUNK_DEVICE
        # Chunks are cut between sets of states, so that tones before states takes no copy of its own.
        num_states = state.shape[-2] if state.ndim > 1 else 1
        sets = state[..., :2].reshape(math.prod(state.shape[:-2]), num_states, 2)
        rows = sets.split(max(1, size // max(1, num_states)))
        response = _join(
            [_join([self._respond(part, receivers) for part in row.split(size, 1)], 2) for row in rows], 0
        )
        response = self._signed(torch.view_as_complex(response.unflatten(-1, (self.num_sensors, 2))))
        return response.transpose(1, 2).reshape(*state.shape[:-1], self.num_tones, self.num_sensors)

    def incoherent(self, state: Tensor) -> Tensor:
        """Mean of `a a^H` over random mode phases: `sum_n |c_n|^2 psi_n psi_n^H`, scaled to trace `|a|^2`.

        Args:
            state: `(*batch, D)` real, `D >= 2`: range m, depth m, ...

        Returns:
            `(*batch, I, M, M)` complex Hermitian.
        """
        position = state[..., :2].reshape(-1, 2)
        distance = position[:, 0].clamp(min=MIN_RANGE)
        power = self._amplitudes(distance, position[:, 1]).square()
        folded = self._fold() if self._folded is None else self._folded
        receivers = torch.view_as_complex(folded[0].unflatten(-1, (self.num_sensors, 2)))
        covariance = torch.stack(
            [
                torch.einsum("sn,nm,nk->smk", p.to(r.dtype), r, r.conj())
                for p, r in zip(
                    power.split(self.mode_counts, 1), receivers.split(self.mode_counts), strict=True
                )
            ],
            dim=1,
        )
        covariance = self._signed(covariance).reshape(*state.shape[:-1], *covariance.shape[1:])
        trace = covariance.diagonal(dim1=-2, dim2=-1).real.sum(-1).clamp(min=_MIN_POWER)
        energy = self(state).abs().square().sum(-1)
        return covariance * (energy / trace)[..., None, None]

    def _signed(self, spectrum: Tensor) -> Tensor:
        return spectrum if self.sign == 1 else spectrum.conj_physical()

    def _travelled(self, distance: Tensor) -> Tensor:
        """`(S, N)` cycles, in float64, by which modes turn on their way over distances `(S,)`."""
        return distance.double()[:, None] * self._cycles

    def _amplitudes(self, distance: Tensor, depth: Tensor) -> Tensor:
        """`(S, N)` amplitudes of the modes that reach the array from ranges and depths `(S,)`."""
        return self._depth_functions(depth) * torch.exp(-distance[:, None] * self._loss)

    def _depth_functions(self, depth: Tensor) -> Tensor:
        """`(S, N)` mode functions at source depths `(S,)`, kept inside the water."""
        bottom = torch.as_tensor(self.water_depth, dtype=depth.dtype, device=depth.device)
        depth = torch.minimum(depth.clamp(min=MIN_DEPTH), bottom)
        return interpolate_modes(self._shapes, depth / self.water_depth)

    def _respond(self, position: Tensor, receivers: Sequence[Tensor]) -> Tensor:
        """`(L, S, 2)` positions to `(L, I, S, 2 M)` responses, real and imaginary parts alternating."""
        flat = position.flatten(0, 1)
        distance = flat[:, 0].clamp(min=MIN_RANGE)
        phase = 2 * math.pi * self._travelled(distance).frac_().to(position.dtype)
        amplitude = self._amplitudes(distance, flat[:, 1])
        parts = [(amplitude * wave).split(self.mode_counts, 1) for wave in (phase.cos(), phase.sin())]
        tones = [
            torch.addmm(real @ rows[0], imag, rows[1]).unflatten(0, position.shape[:2])
            for real, imag, rows in zip(*parts, receivers, strict=True)
        ]
        response = torch.stack(tones, dim=1)
        if self.normalize:
            return response / torch.linalg.vector_norm(response, dim=-1, keepdim=True).clamp(min=_MIN_NORM)
        return response * distance.rsqrt().reshape(len(position), 1, -1, 1)

    def _fold(self) -> Tensor:
        """Receivers with `exp(i k_n (r - r_m))`: what cosines and sines multiply, in real numbers."""
        tilt = torch.as_tensor(self.tilt, dtype=torch.float64, device=self._heights.device)
        along = self._heights / self._heights.max().clamp(min=MIN_DEPTH)
        nearer = torch.tan(torch.deg2rad(tilt)) * self._heights + 4 * self.bow * along * (1 - along)
        phase = -2 * math.pi * self._cycles[:, None] * nearer
        gain = self._receivers * torch.exp(self._loss.double()[:, None] * nearer)
        real, imag = gain * torch.cos(phase), gain * torch.sin(phase)
        rows = torch.stack([torch.stack([real, imag], dim=-1), torch.stack([-imag, real], dim=-1)])
        return rows.flatten(-2).to(self._shapes.dtype)


def _join(parts: Sequence[Tensor], dim: int) -> Tensor:
    """Concatenate; a single part is taken as it is."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts), dim)
