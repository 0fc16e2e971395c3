"""Field of a point source over a sloping bottom, as a sum of adiabatic normal modes."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

from torchdt.field.waveguide.environment import Environment
from torchdt.field.waveguide.modes import solve_modes
from torchdt.field.waveguide.shapes import hermite_rows, interleave, interpolate_modes
from torchdt.field.waveguide.waveguide import MIN_DEPTH, NormalModeField

# Change of water depth between two solutions, m, at most. Wavenumbers are linear in between: what that leaves
# out of a mode's phase is some hundredths of a radian at 5 km and 400 Hz.
_STEP = 1.0


class SlopedField(NormalModeField):
    """Response where the water depth changes linearly with the range, all around the array.

    Each mode keeps its energy to itself: `psi_n(z_s) psi_n(z_m) exp(-i int_0^r k_n(r') dr') / sqrt(kr_n r)`,
    with `psi_n(z_s)` that of the depth at the source, `psi_n(z_m)` and `kr_n` those at the array: the
    adiabatic approximation of Jensen, Kuperman, Porter and Schmidt, Computational Ocean Acoustics, 2nd ed.
    2011, ch. 5. Layers below the water follow the slope. A mode that the depth at the source does not have
    does not reach the array; it fades out over the last metre of depth that has it.

    All else is as in `NormalModeField`.

    Args:
        environment: the waveguide at the array.
        freqs, sensor_depths, tilt: see `NormalModeField`.
        slope: rise of the bottom over the range, positive where it gets shallower away from the array.
        length: range at which the slope ends, m; the bottom is flat beyond.
        max_phase_speed, points_per_wavelength: see `NormalModeField`.
        options: further keywords of `NormalModeField`.

    Raises:
        ValueError: where the slope leaves no water, or an argument does not fit `NormalModeField`.
        ModeSolverError: if the modes cannot be computed.
    """

    _exact = (*NormalModeField._exact, "_sloped_cycles", "_sloped_loss")
    _sloped_shapes: (
        Tensor  # (H + 1, 2 G, N) `_shapes` from the array to beyond the end of the slope, zero where absent
    )
    _added: Tensor | None = (
        None  # (2 G, N) on top of `_sloped_shapes` everywhere, while an environment is fitted
    )
    _sloped_cycles: Tensor  # (H + 1, N) `_cycles` likewise, float64
    _sloped_loss: Tensor  # (H + 1, N) `_loss` likewise, float64

    def __init__(
        self,
        environment: Environment,
        freqs: Sequence[float],
        sensor_depths: Sequence[float],
        tilt: float | Tensor = 0.0,
        *,
        slope: float,
        length: float,
        max_phase_speed: float = 1750.0,
        points_per_wavelength: float = 16.0,
        **options: Any,
    ) -> None:
        solver = (max_phase_speed, points_per_wavelength)
        super().__init__(
            environment,
            freqs,
            sensor_depths,
            tilt,
            max_phase_speed=max_phase_speed,
            points_per_wavelength=points_per_wavelength,
            **options,
        )
        rise, depth = slope * length, environment.water_depth
        if not (math.isfinite(rise) and length > 0 and rise < depth):
            expected = f"a finite one that leaves some of {depth} m of water"
            raise ValueError(f"slope is {slope} over {length} m; expected {expected}")
        self.slope: float | Tensor = slope
        self.length = length
        self.num_intervals = max(1, math.ceil(abs(rise) / _STEP))
        # Nodes lie at the same depths for all slopes, whose solutions are remembered.
        step = min(_STEP, abs(rise))
        self.interval: float | Tensor = step / abs(slope) if slope else length
        tables = [[solve_modes(environment, float(f), *solver) for f in freqs]]
        num_cells = len(tables[0][0].depth) - 1
        for part in range(1, self.num_intervals + 1):
            local = environment.perturbed(water_depth=depth - math.copysign(step * part, rise))
            # As many cells in any depth of water, so that one tensor holds all of them.
            cell = local.water_depth / (num_cells - 0.5)
            tables.append([solve_modes(local, float(f), *solver, cell) for f in freqs])
        shapes = [self._joined([interleave(table, None) for table in node]) for node in tables]
        cycles, loss = (
            _carried(
                [self._joined([torch.tensor(getattr(table, name)) for table in node]) for node in tables]
            )
            for name in ("wavenumber", "attenuation")
        )
        for name, value, kind in (
            ("_sloped_shapes", _aligned(shapes), self._shapes.dtype),
            ("_sloped_cycles", cycles / (-2 * math.pi), torch.float64),
            ("_sloped_loss", loss, torch.float64),
        ):
            self.register_buffer(name, value.to(self._shapes.device, kind), persistent=False)

    def _joined(self, tones: Sequence[Tensor]) -> Tensor:
        """`(..., N)` of the modes that the array has, zero for those that are not there."""
        pairs = zip(tones, self.mode_counts, strict=True)
        return torch.cat([pad(modes, (0, count - modes.shape[-1])) for modes, count in pairs], -1)

    def _place(self, distance: Tensor) -> Tensor:
        """Ranges `(S,)` in intervals of the slope, up to its end."""
        return (distance.clamp(max=self.length) / self.interval).clamp(max=self.num_intervals)

    def _travelled(self, distance: Tensor) -> Tensor:
        return self._integral(self._sloped_cycles, distance.double())

    def _amplitudes(self, distance: Tensor, depth: Tensor) -> Tensor:
        place = self._place(distance)
        cell = place.detach().long().clamp(max=self.num_intervals - 1)
        within = place - cell
        bottom = self.water_depth - self.slope * distance.clamp(max=self.length)
        inside = torch.minimum(depth.clamp(min=MIN_DEPTH), bottom)
        height = self._sloped_shapes.shape[1]
        rows, weights = [], []
        for node, weight in ((cell, 1 - within), (cell + 1, within)):  # linear between the nodes
            local = self.water_depth - self.slope * self.interval * node
            row, mix = hermite_rows(height // 2 - 1, (inside / local).clamp(max=1.0))
            rows.append(row + height * node[:, None])
            weights.append(mix * weight[:, None])
        value = embedding_bag(
            torch.cat(rows, -1),
            self._sloped_shapes.flatten(0, 1),
            per_sample_weights=torch.cat(weights, -1).to(depth.dtype),
            mode="sum",
        )
        if self._added is not None:
            value = value + interpolate_modes(self._added, (inside / bottom).to(depth.dtype))
        lost = self._integral(self._sloped_loss, distance.double())
        return value * torch.exp(-lost).to(value.dtype)

    def _integral(self, rate: Tensor, distance: Tensor) -> Tensor:
        """Integral over ranges `(S,)` of what is linear between values `(H + 1, N)`, and constant beyond."""
        whole = (rate[1:] + rate[:-1]).cumsum(0) * (self.interval / 2)
        whole = torch.cat([torch.zeros_like(rate[:1]), whole])
        place = self._place(distance)
        cell = place.detach().long().clamp(max=self.num_intervals - 1)
        share = (place - cell)[:, None]
        rise = share * (rate[cell + 1] - rate[cell])
        within = self.interval * share * (rate[cell] + rise / 2)
        return whole[cell] + within + (distance - self.length).clamp(min=0)[:, None] * (rate[cell] + rise)


def _aligned(shapes: Sequence[Tensor]) -> Tensor:
    """`(H + 1, 2 G, N)`: each mode with the sign that it has a little nearer to the array."""
    signed = [shapes[0]]
    for further in shapes[1:]:
        signed.append(further * torch.sign((further * signed[-1]).sum(0)))
    return torch.stack(signed)


def _carried(values: Sequence[Tensor]) -> Tensor:
    """`(H + 1, N)`, with the last value of a mode where it is no longer there."""
    carried = [values[0]]
    for further in values[1:]:
        carried.append(torch.where(further == 0, carried[-1], further))
    return torch.stack(carried)
