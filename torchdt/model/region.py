"""The region of interest: coordinates, their limits, and the cells in which objects are born."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchdt.errors import require
from torchdt.field.base import BoundedField, Field
from torchdt.ranges import Finite, Positive, check

MOST_CELLS = 10_000_000
"""Of a region: what their centres take is a small part of a machine's memory."""


@dataclass(frozen=True)
class Coordinate:
    """One position coordinate and its rate.

    Attributes:
        name: for example `range`.
        unit: of the position, for example `m`; rates are in `unit` per second (`mps`).
        low, high: limits of the region, in units.
        cell: edge of a birth cell, in units; the region holds a whole number of cells.
        rate_low, rate_high: rates of newborn objects are uniform between these.
        driving_variance: variance of the acceleration-like driving noise, (unit / s^2)^2.
    """

    name: str
    unit: str
    low: Finite
    high: Finite
    cell: Positive
    rate_low: Finite
    rate_high: Finite
    driving_variance: Positive

    def __post_init__(self) -> None:
        key = f"scenario.coordinates.{self.name}"
        check(self, key)
        for name, low, high in (("low", self.low, self.high), ("rate_low", self.rate_low, self.rate_high)):
            other = name.replace("low", "high")
            require(low < high, f"{key}.{name}", low, f"a number below {other}, {high}")
        width = self.high - self.low
        require(self.cell <= width, f"{key}.cell", self.cell, f"at most the region's width, {width}")
        finest = width / MOST_CELLS
        require(
            self.cell >= finest, f"{key}.cell", self.cell, f"at least {finest:.3g}, a region of fewer cells"
        )

    @property
    def num_cells(self) -> int:
        """Number of birth cells along this coordinate."""
        return max(1, round((self.high - self.low) / self.cell))


class Region:
    """Support of the object states: a box in position, or what a field leaves of it; all rates.

    Args:
        coordinates: the d position coordinates, slowest-varying grid axis first.
        dtype, device: of the tensors handed out.
        inside: where in the box there can be objects, `(*batch, D)` states to `(*batch,)` bool; None is
            everywhere.

    Raises:
        InputError: where there can be objects in none of the birth cells.
    """

    def __init__(
        self,
        coordinates: Sequence[Coordinate],
        dtype: torch.dtype = torch.float32,
        device: torch.device | str = "cpu",
        inside: Callable[[Tensor], Tensor] | None = None,
    ):
        self.coordinates, self._inside = tuple(coordinates), inside

        def vector(values: Sequence[float]) -> Tensor:
            return torch.tensor(values, dtype=dtype, device=device)

        self.low = vector([c.low for c in self.coordinates])
        self.high = vector([c.high for c in self.coordinates])
        self.rate_low = vector([c.rate_low for c in self.coordinates])
        self.rate_high = vector([c.rate_high for c in self.coordinates])
        self.driving_variance = vector([c.driving_variance for c in self.coordinates])
        self.grid_shape = tuple(c.num_cells for c in self.coordinates)
        self.cell = (self.high - self.low) / vector([float(n) for n in self.grid_shape])
        number = math.prod(self.grid_shape)
        require(number <= MOST_CELLS, "scenario.coordinates", f"{number} cells", f"at most {MOST_CELLS}")
        found = f"{number} cells, none of them where an object can be"
        require(self.num_cells > 0, "scenario.coordinates", found, "a region with room for objects")

    def within(self, field: Field) -> "Region":
        """What a field leaves of this region: the region itself unless it is a `BoundedField`."""
        if not isinstance(field, BoundedField):
            return self
        return Region(self.coordinates, self.low.dtype, self.low.device, field.inside)

    @property
    def num_coordinates(self) -> int:
        """Number d of position coordinates; a state has 2 d entries."""
        return len(self.coordinates)

    @cached_property
    def num_cells(self) -> int:
        """Number Q of birth cells: those of the grid that reach into the region."""
        return math.prod(self.grid_shape) if self._inside is None else int(self.is_birth_cell.sum())

    @cached_property
    def is_birth_cell(self) -> Tensor:
        """Whether a cell of the grid reaches into the region, `(C,)` bool.

        It does with its centre, a corner or the middle of a side.
        """
        centres = self.cell_centres()
        if self._inside is None:
            return torch.ones_like(centres[:, 0], dtype=torch.bool)
        ends = torch.tensor([0.0, -0.5, 0.5], dtype=centres.dtype, device=centres.device)
        offsets = torch.cartesian_prod(*[ends] * self.num_coordinates).reshape(-1, self.num_coordinates)
        reaches = [self._inside(centres + offset * self.cell) for offset in offsets]
        return torch.stack(reaches).any(0)

    def cell_centres(self) -> Tensor:
        """Centres of all C cells of the grid, birth cells or not, `(C, d)`, last coordinate fastest."""
        axes = [
            low + cell * (torch.arange(n, dtype=low.dtype, device=low.device) + 0.5)
            for low, cell, n in zip(self.low, self.cell, self.grid_shape, strict=True)
        ]
        return torch.cartesian_prod(*axes).reshape(-1, self.num_coordinates)

    def contains(self, state: Tensor) -> Tensor:
        """Whether positions lie in the region, `(*batch, D)` to `(*batch,)` bool."""
        position = state[..., : self.num_coordinates]
        holds = ((position >= self.low) & (position <= self.high)).all(-1)
        return holds if self._inside is None else holds & self._inside(position)

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the 2 d state entries for tables: positions, then rates."""
        positions = [f"{c.name}_{c.unit}" for c in self.coordinates]
        rates = [f"{c.name}_rate_{c.unit}ps" for c in self.coordinates]
        return (*positions, *rates)


def per_coordinate(values: Sequence[float] | None, default: Tensor, key: str) -> Tensor:
    """A setting with one number for each coordinate, `(d,)`; the default where it is None.

    Raises:
        InputError: naming the key, where the numbers are not as many as the coordinates.
    """
    if values is None:
        return default
    require(len(values) == len(default), key, values, f"one number for each of {len(default)} coordinates")
    return default.new_tensor(values)
