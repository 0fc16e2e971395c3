"""The region of interest: coordinates, their limits, and the cells in which objects are born."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchdt.core import period
from torchdt.core.errors import require
from torchdt.core.ranges import Finite, Positive, check
from torchdt.field.base import BaseField, Field, as_field, of_each
from torchdt.model.ambiguity import refuse_images, refuse_other_periods

if TYPE_CHECKING:
    from torchdt.model.motion.base import Motion

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
        period: of a coordinate that goes round, in units: x and x + period are the same place, such as 360
            for an azimuth in degrees. A region of a whole period has no ends. None: the coordinate is a line.
        report_low, report_high: what is reported and scored, where that is less than the region; objects
            beyond are tracked, so that they are not taken for others. None is the end of the region.

    Raises:
        InputError: where a number is not finite, the limits leave nothing, or more than one period.
    """

    name: str
    unit: str
    low: Finite
    high: Finite
    cell: Positive
    rate_low: Finite
    rate_high: Finite
    driving_variance: Positive
    period: Positive | None = None
    report_low: Finite | None = None
    report_high: Finite | None = None

    def __post_init__(self) -> None:
        key = f"scenario.coordinates.{self.name}"
        check(self, key)
        for name, low, high in (("low", self.low, self.high), ("rate_low", self.rate_low, self.rate_high)):
            other = name.replace("low", "high")
            require(low < high, f"{key}.{name}", low, f"a number below {other}, {high}")
        width = self.high - self.low
        require(self.cell <= width, f"{key}.cell", self.cell, f"at most the region's width, {width}")
        if self.period is not None:
            most = f"at least the region's width, {width}, or null"
            require(self.is_closed or self.period > width, f"{key}.period", self.period, most)
        low, high = self.report
        within = f"a number between low, {self.low}, and high, {self.high}"
        require(self.low <= low < self.high, f"{key}.report_low", low, within)
        require(low < high <= self.high, f"{key}.report_high", high, f"{within}, above report_low, {low}")
        finest = width / MOST_CELLS
        require(
            self.cell >= finest, f"{key}.cell", self.cell, f"at least {finest:.3g}, a region of fewer cells"
        )

    @property
    def num_cells(self) -> int:
        """Number of birth cells along this coordinate."""
        return max(1, round((self.high - self.low) / self.cell))

    @property
    def report(self) -> tuple[float, float]:
        """Limits of what is reported."""
        low, high = self.report_low, self.report_high
        return self.low if low is None else low, self.high if high is None else high

    @property
    def is_closed(self) -> bool:
        """Whether the region goes all the way round, without ends."""
        return self.period is not None and math.isclose(self.period, self.high - self.low, rel_tol=1e-6)


class Region:
    """Support of the object states: a box in position, or what a field leaves of it; all rates.

    Of a coordinate with a period, all values that are whole turns apart are one place, and any of them may
    stand for it: particles go on where they are, and only what is reported is wrapped.

    Args:
        coordinates: the d position coordinates, slowest-varying grid axis first.
        dtype, device: of the tensors handed out.
        inside: where in the box there can be objects, `(*batch, D)` states to `(*batch,)` bool; None is
            everywhere, or where the field says.
        field: what else limits the box, see `within`.
        motion: what states have beside their position; None stands for rates, as constant velocity has them.

    Attributes:
        low, high: `(d,)` corners of the box.
        lower_end, upper_end: `(d,)` what no position passes: the corners, but infinite where the region goes
            all the way round.
        period: `(d,)`, infinite for a coordinate that does not go round.
        report_low, report_high: `(d,)` corners of what is reported.

    Raises:
        InputError: where there is no coordinate, or there can be objects in none of the birth cells.
    """

    def __init__(
        self,
        coordinates: Sequence[Coordinate],
        dtype: torch.dtype = torch.float32,
        device: torch.device | str = "cpu",
        inside: Callable[[Tensor], Tensor | None] | None = None,
        field: BaseField | None = None,
        motion: "Motion | None" = None,
    ):
        self.coordinates, self._field, self._motion = tuple(coordinates), field, motion
        require(len(self.coordinates) > 0, "scenario.coordinates", "none", "one coordinate or more")

        def vector(values: Sequence[float]) -> Tensor:
            return torch.tensor(values, dtype=dtype, device=device)

        self.low = vector([c.low for c in self.coordinates])
        self.high = vector([c.high for c in self.coordinates])
        self.rate_low = vector([c.rate_low for c in self.coordinates])
        self.rate_high = vector([c.rate_high for c in self.coordinates])
        self.driving_variance = vector([c.driving_variance for c in self.coordinates])
        round_trip = [math.inf if c.period is None else c.period for c in self.coordinates]
        closed = torch.tensor([c.is_closed for c in self.coordinates], device=device)
        self.period = torch.where(closed, self.high - self.low, vector(round_trip))
        self.lower_end = self.low.masked_fill(closed, -torch.inf)
        self.upper_end = self.high.masked_fill(closed, torch.inf)
        self.report_low = vector([c.report[0] for c in self.coordinates])
        self.report_high = vector([c.report[1] for c in self.coordinates])
        self.reports_all = all(c.report == (c.low, c.high) for c in self.coordinates)
        self.has_period = any(c.period is not None for c in self.coordinates)
        self.grid_shape = tuple(c.num_cells for c in self.coordinates)
        self.cell = (self.high - self.low) / vector([float(n) for n in self.grid_shape])
        if field is not None:
            somewhere = of_each(field, self.complete(self.cell_centres()[:1]))
            inside = None if field.inside(somewhere) is None else field.inside
        self._inside = inside
        number = math.prod(self.grid_shape)
        require(number <= MOST_CELLS, "scenario.coordinates", f"{number} cells", f"at most {MOST_CELLS}")
        found = f"{number} cells, none of them where an object can be"
        require(self.num_cells > 0, "scenario.coordinates", found, "a region with room for objects")

    def within(self, field: Field, motion: "Motion | None" = None) -> "Region":
        """What a field leaves of this region, see `BaseField.inside`; of states of a motion.

        Raises:
            InputError: where the field has states of other coordinates, leaves nothing, leaves other cells to
                one sequence than to another, cannot tell some states of the region from others, or does not
                repeat itself with the region's periods.
        """
        field = as_field(field)
        found, expected = f"{self.num_coordinates} coordinates", f"{field.num_coordinates}, as the field"
        require(self.num_coordinates == field.num_coordinates, "scenario.coordinates", found, expected)
        motion = self._motion if motion is None else motion
        left = Region(self.coordinates, self.low.dtype, self.low.device, field=field, motion=motion)
        refuse_images(left, field)
        refuse_other_periods(left, field)
        return left

    def select(self, sequences: slice | Sequence[int]) -> "Region":
        """The region for some sequences of a batch; the same object where these are all, or share a field."""
        field = None if self._field is None else self._field.select(sequences)
        if field is None or field is self._field:
            return self
        other = copy.copy(self)
        other._field, other._inside = field, None if self._inside is None else field.inside
        return other

    @property
    def num_coordinates(self) -> int:
        """Number d of position coordinates."""
        return len(self.coordinates)

    @property
    def num_entries(self) -> int:
        """Number D of entries of a state: positions, then what the motion has beside them."""
        return len(self.column_names)

    @cached_property
    def num_cells(self) -> int:
        """Number Q of birth cells: those of the grid that reach into the region."""
        return math.prod(self.grid_shape) if self._inside is None else int(self.is_birth_cell.sum())

    @cached_property
    def is_birth_cell(self) -> Tensor:
        """Whether a cell of the grid reaches into the region, `(C,)` bool.

        It does with its centre, a corner or the middle of a side.

        Raises:
            InputError: where the cells of one sequence are not those of another.
        """
        centres = self.cell_centres()
        ends = torch.tensor([0.0, -0.5, 0.5], dtype=centres.dtype, device=centres.device)
        offsets = torch.cartesian_prod(*[ends] * self.num_coordinates).reshape(-1, self.num_coordinates)
        reached = torch.zeros_like(centres[:, 0], dtype=torch.bool)
        for offset in offsets:
            state = centres + offset * self.cell
            allowed = self._allowed(state if self._field is None else of_each(self._field, state))
            if allowed is None:
                return torch.ones_like(reached)
            reached = reached | allowed
        if reached.ndim > 1:
            alike = bool((reached == reached[:1]).all())
            require(alike, "fields", "different cells where objects can be", "the same for all sequences")
            return reached[0]
        return reached

    def complete(self, position: Tensor) -> Tensor:
        """Whole states: positions `(*batch, d)` with rates in the middle of theirs, states as they are."""
        if position.shape[-1] != self.num_coordinates:
            return position
        if self._motion is not None:
            return self._motion.complete(self, position)
        middle = (self.rate_low + self.rate_high) / 2
        return torch.cat([position, middle.expand_as(position)], -1)

    def cell_centres(self) -> Tensor:
        """Centres of all C cells of the grid, birth cells or not, `(C, d)`, last coordinate fastest."""
        axes = [
            low + cell * (torch.arange(n, dtype=low.dtype, device=low.device) + 0.5)
            for low, cell, n in zip(self.low, self.cell, self.grid_shape, strict=True)
        ]
        return torch.cartesian_prod(*axes).reshape(-1, self.num_coordinates)

    def cell_of(self, position: Tensor) -> Tensor:
        """Cell of the grid that holds, or is nearest to, positions `(*batch, d)`, `(*batch,)` int64."""
        index = ((self.wrap(position) - self.low) / self.cell).floor().long()
        cell = torch.zeros_like(index[..., 0])
        for along, num in zip(index.unbind(-1), self.grid_shape, strict=True):
            cell = cell * num + along.clamp(0, num - 1)
        return cell

    def contains(self, state: Tensor) -> Tensor:
        """Whether positions lie in the region, `(*batch, D)` to `(*batch,)` bool."""
        state = self.wrap(state)
        position = state[..., : self.num_coordinates]
        holds = ((position >= self.lower_end) & (position <= self.upper_end)).all(-1)
        allowed = self._allowed(state)
        return holds if allowed is None else holds & allowed

    def reports(self, position: Tensor) -> Tensor:
        """Whether objects at positions of the region are reported, `(*batch, d)` to `(*batch,)` bool."""
        if self.reports_all:
            return torch.ones_like(position[..., 0], dtype=torch.bool)
        position = self.wrap(position)
        return ((position >= self.report_low) & (position <= self.report_high)).all(-1)

    def wrap(self, state: Tensor) -> Tensor:
        """Positions or states `(*batch, D)` at the same places, within one period from the lower corner."""
        return self._moved(state, lambda position: period.wrap(position, self.low, self.period))

    def difference(self, position: Tensor, other: Tensor) -> Tensor:
        """`position - other` the shortest way round, `(*batch, d)`."""
        difference = position - other
        return period.shortest(difference, self.period) if self.has_period else difference

    def nearest(self, position: Tensor, centre: Tensor) -> Tensor:
        """Positions `(*batch, d)` at the same places, where these are closest to a centre."""
        return period.nearest(position, centre, self.period) if self.has_period else position

    def gather(self, state: Tensor, log_weight: Tensor) -> Tensor:
        """Particles `(*batch, P, D)` at the same places, without a seam in between, see `period.gather`.

        Moments of the result are those of the cloud, and its mean is what `wrap` leaves as it is.

        Args:
            state: `(*batch, P, D)`.
            log_weight: `(*batch, P)` normalised.
        """
        return self._moved(state, lambda p: period.gather(p, log_weight, self.low, self.period))

    def _moved(self, state: Tensor, move: Callable[[Tensor], Tensor]) -> Tensor:
        if not self.has_period:
            return state
        position, rest = state.tensor_split([self.num_coordinates], -1)
        return torch.cat([move(position), rest], -1)

    def _allowed(self, state: Tensor) -> Tensor | None:
        return None if self._inside is None else self._inside(self.complete(state))

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the entries of a state for tables: positions, then what the motion has beside them."""
        if self._motion is not None:
            return self._motion.column_names(self.coordinates)
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
