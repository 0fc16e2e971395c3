"""Waveguides beside the nominal one: sound-speed EOFs, array tilt and water depth as parameters.

A mode solver is not differentiable, but wavenumbers and mode functions are smooth in the environment.
Central differences at one environment give a field that is exact there, right to first order around it,
and differentiable in the parameters.
"""

import copy
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.core.support import REAL, Quantity
from torchdt.field.base import Field
from torchdt.field.build import EnvironmentDraw
from torchdt.field.waveguide.shapes import interpolate_modes
from torchdt.field.waveguide.sloped import SlopedField
from torchdt.field.waveguide.waveguide import NormalModeField

ENVIRONMENT = {
    "eof_coefficients": Quantity(REAL, vector=True),
    "tilt_deg": Quantity(REAL),
    "water_depth_m": Quantity(REAL),
}
"""What a likelihood can be differentiated in: changes of the environment from the nominal one."""

_MODAL = ("_shapes", "_loss", "_cycles", "_receivers")


def draw_of(theta: Tensor) -> EnvironmentDraw:
    """Departure from the nominal environment of parameters `(E + 2,)`."""
    *eofs, tilt, depth = theta.tolist()
    return EnvironmentDraw(tuple(eofs), tilt, depth)


class WaveguideFamily:
    """Fields by parameters `theta = (EOF coefficients ..., tilt in degrees, water depth change in m)`.

    Args:
        solve: makes the normal-mode field of a departure from the nominal environment.
        eof_std: prior standard deviations of the EOF coefficients.
        tilt_std_deg: of the tilt, degrees.
        water_depth_std_m: of the water depth, m.
        device: of the parameters.
    """

    def __init__(
        self,
        solve: Callable[[EnvironmentDraw], NormalModeField],
        eof_std: Sequence[float],
        tilt_std_deg: float,
        water_depth_std_m: float,
        device: torch.device | str = "cpu",
    ):
        self._solve = solve
        self.prior_std = torch.tensor(
            [*eof_std, tilt_std_deg, water_depth_std_m], dtype=torch.float64, device=device
        )

    def solve(self, theta: Tensor) -> NormalModeField:
        """Exact field of parameters `(E + 2,)`."""
        return self._solve(draw_of(theta))

    def linearise(self, theta0: Tensor) -> Callable[[Tensor], Field]:
        """Fields around `theta0`, differentiable in theta.

        Args:
            theta0: `(E + 2,)` float64.

        Returns:
            A function from theta to the field: exact in the tilt, of first order in all else. Modes that only
            some neighbouring environments have, at the edge of the phase speeds kept, are left out.

        Raises:
            InputError: where the bottom is not flat.
        """
        centre = self.solve(theta0)
        flat = not isinstance(centre, SlopedField)
        require(flat, "field.slope_m_per_km", "a slope", "0, where the environment is fitted or tuned")
        modal = [j for j in range(len(theta0)) if j != len(theta0) - 2]
        sides = []
        for j in modal:
            step = torch.zeros_like(theta0)
            step[j] = 0.5 * self.prior_std[j]
            sides.append((self.solve(theta0 + step), self.solve(theta0 - step), self.prior_std[j]))
        # A mode at the edge of the phase speeds kept may exist on one side only.
        counts = [f.mode_counts for pair in sides for f in pair[:2]] + [centre.mode_counts]
        common = [min(counts) for counts in zip(*counts, strict=True)]
        base = _modal_tables(centre, centre, common)
        slopes = []
        for above, below, width in sides:
            up, down = _modal_tables(above, centre, common), _modal_tables(below, centre, common)
            slopes.append({name: (up[name] - down[name]) / width for name in _MODAL})

        def field_at(theta: Tensor) -> Field:
            change = theta - theta0
            field = copy.copy(centre)
            tables = {
                name: base[name]
                + sum(change[j].to(s[name]) * s[name] for j, s in zip(modal, slopes, strict=True))
                for name in _MODAL
            }
            field._buffers = {**centre._buffers, **tables, "_folded": None}
            field.mode_counts = common
            field.water_depth = centre.water_depth + change[-1]
            field.tilt = centre.tilt + change[-2]
            return field

        return field_at


def _modal_tables(
    field: NormalModeField, reference: NormalModeField, counts: Sequence[int]
) -> dict[str, Tensor]:
    """Mode tables on the reference's depth grid, first `counts` modes of each tone, signs alike."""
    tables = {name: _first_modes(getattr(field, name), name, field.mode_counts, counts) for name in _MODAL}
    shapes = _first_modes(reference._shapes, "_shapes", reference.mode_counts, counts)
    if len(tables["_shapes"]) != len(shapes):
        tables["_shapes"] = _regrid(tables["_shapes"], len(shapes) // 2)
    sign = torch.sign((tables["_shapes"] * shapes).sum(0))
    tables["_shapes"] = tables["_shapes"] * sign
    tables["_receivers"] = tables["_receivers"] * sign[:, None].to(tables["_receivers"])
    return tables


def _first_modes(table: Tensor, name: str, have: Sequence[int], keep: Sequence[int]) -> Tensor:
    dim = 1 if name == "_shapes" else 0
    parts = table.split(list(have), dim)
    return torch.cat([part.narrow(dim, 0, count) for part, count in zip(parts, keep, strict=True)], dim)


def _regrid(shapes: Tensor, num_nodes: int) -> Tensor:
    """Values and scaled slopes, row by row in turn, on another number of nodes from surface to seafloor."""
    fraction = torch.linspace(0, 1, num_nodes, dtype=shapes.dtype, device=shapes.device)
    near = 1e-3 / num_nodes
    above, below = (fraction + near).clamp_max(1.0), (fraction - near).clamp_min(0.0)
    rise = interpolate_modes(shapes, above) - interpolate_modes(shapes, below)
    slope = rise / (above - below)[:, None] / (num_nodes - 1)
    return torch.stack([interpolate_modes(shapes, fraction), slope], 1).flatten(0, 1)
