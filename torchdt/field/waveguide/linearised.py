"""Normal-mode fields to first order around one of them, from fields on both sides of it."""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.field.waveguide.shapes import interpolate_modes
from torchdt.field.waveguide.sloped import SlopedField
from torchdt.field.waveguide.waveguide import NormalModeField

_MODAL = ("_shapes", "_loss", "_cycles", "_receivers")
_CARRIED = ("_loss", "_cycles")  # those that add up along a slope
_SLOPED = ("_shapes", *_CARRIED)  # those that a sloped field also has along the range
_Tables = dict[str, Tensor]
_BEGINNING = 12
"""Intervals of a slope that may begin."""
_FLATTEST = 1e-3
"""Share of a slope that is left at least where it gets flatter."""


class Sides(NamedTuple):
    """Two fields over a flat bottom, at `above` and `below` a value of one parameter.

    Attributes:
        above, below: the fields.
        width: by how much the parameter differs between them.
    """

    above: NormalModeField
    below: NormalModeField
    width: float


class Departure(NamedTuple):
    """How a field departs from that in the middle.

    Attributes:
        modal: `(P,)` changes of the parameters that have sides.
        water_depth: change of the water depth, m, which is one of them or zero.
        tilt: of the tilt, degrees.
        bow: of the bow, m.
        slope: of the slope of the bottom, positive where it gets shallower away from the array.
    """

    modal: Tensor
    water_depth: Tensor | float
    tilt: Tensor | float
    bow: Tensor | float
    slope: Tensor | float


class LinearisedModes:
    """Fields around one of them, differentiable in the departure.

    Exact in tilt, bow and a slope that there is, of first order in wavenumbers and mode functions otherwise.
    Over a slope the changes of those that have sides are the same all along the way. Where a slope begins
    wavenumbers change as linear functions of `1 / D^2`, which is exact for an ideal waveguide, and mode
    functions stay what they are at their fraction of the depth. Modes that only some of the fields have, at
    the edge of the phase speeds kept, are left out.

    Args:
        centre: the field in the middle.
        sides: of each parameter that changes the modes and is free to.
        deeper: sides of the water depth, where a slope may begin at `centre`, which has hardly any.
    """

    def __init__(self, centre: NormalModeField, sides: Sequence[Sides], deeper: Sides | None = None):
        self._centre = centre
        # A mode at the edge of the phase speeds kept may exist on one side only.
        around = [*sides, *([] if deeper is None else [deeper])]
        counts = [field.mode_counts for side in around for field in side[:2]] + [centre.mode_counts]
        self._counts = [min(numbers) for numbers in zip(*counts, strict=True)]
        self._base = _modal_tables(centre, centre, self._counts)
        self._slopes = [self._change(side) for side in sides]
        self._deeper = None if deeper is None else self._change(deeper)
        self._along = _Tables()
        if isinstance(centre, SlopedField):
            tables = {n: getattr(centre, f"_sloped{n}") for n in _SLOPED}
            self._along = {
                n: _first_modes(t, -1, centre.mode_counts, self._counts) for n, t in tables.items()
            }
            if deeper is not None:
                self._along = {n: t[:1].repeat_interleave(_BEGINNING + 1, 0) for n, t in self._along.items()}

    def _change(self, side: Sides) -> _Tables:
        up, down = (_modal_tables(field, self._centre, self._counts) for field in side[:2])
        return {name: (up[name] - down[name]) / side.width for name in _MODAL}

    def at(self, departure: Departure) -> NormalModeField:
        """The field of a departure."""
        changes = {
            name: sum(d.to(s[name]) * s[name] for d, s in zip(departure.modal, self._slopes, strict=True))
            for name in _MODAL
        }
        tables = {name: self._base[name] + changes[name] for name in _MODAL}
        field = copy.copy(self._centre)
        if isinstance(field, SlopedField):
            tables["_sloped_shapes"] = self._along["_shapes"]
            field._added = changes["_shapes"] if self._slopes else None
            tables |= {f"_sloped{n}": self._along[n] + changes[n] for n in _CARRIED}
            before, field.slope = field.slope, field.slope + departure.slope
            if self._deeper is None:  # nodes keep their depths
                field.interval = field.interval / torch.as_tensor(field.slope / before).clamp_min(_FLATTEST)
            else:  # nodes keep their ranges
                field.num_intervals, field.interval = _BEGINNING, field.length / _BEGINNING
                nodes = field.interval * torch.arange(_BEGINNING + 1).to(field._heights)
                depth = field.water_depth
                shift = depth / 2 * (1 - (depth / (depth - field.slope * nodes)).square())
                for name in _CARRIED:
                    tables[f"_sloped{name}"] = tables[f"_sloped{name}"] + shift[:, None] * self._deeper[name]
        field._buffers = {**self._centre._buffers, **tables, "_folded": None}
        field.mode_counts = self._counts
        field.water_depth = field.water_depth + departure.water_depth
        field.tilt, field.bow = field.tilt + departure.tilt, field.bow + departure.bow
        return field


def _modal_tables(field: NormalModeField, reference: NormalModeField, counts: Sequence[int]) -> _Tables:
    """Mode tables on the reference's depth grid, first `counts` modes of each tone, signs alike."""
    dims = {"_receivers": 0}
    tables = {
        name: _first_modes(getattr(field, name), dims.get(name, -1), field.mode_counts, counts)
        for name in _MODAL
    }
    shapes = _first_modes(reference._shapes, -1, reference.mode_counts, counts)
    if len(tables["_shapes"]) != len(shapes):
        tables["_shapes"] = _regrid(tables["_shapes"], len(shapes) // 2)
    sign = torch.sign((tables["_shapes"] * shapes).sum(0))
    tables["_shapes"] = tables["_shapes"] * sign
    tables["_receivers"] = tables["_receivers"] * sign[:, None].to(tables["_receivers"])
    return tables


def _first_modes(table: Tensor, dim: int, have: Sequence[int], keep: Sequence[int]) -> Tensor:
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
