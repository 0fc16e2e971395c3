"""Peaks of a surface over a regular grid, kept apart from each other."""

import math
from typing import NamedTuple, Self

import torch
from torch import Tensor
from torch.nn import functional

from torchdt.core.errors import require
from torchdt.core.period import shortest
from torchdt.model.region import Region

POOL = {1: functional.max_pool1d, 2: functional.max_pool2d, 3: functional.max_pool3d}


class Grid(NamedTuple):
    """Cells of a regular grid, last coordinate fastest.

    Attributes:
        shape: number of cells along each of the d coordinates.
        closed: for each, whether the last cell is a neighbour of the first.
    """

    shape: tuple[int, ...]
    closed: tuple[bool, ...]

    @classmethod
    def of(cls, region: Region) -> Self:
        """The cells of a region."""
        return cls(region.grid_shape, tuple(c.is_closed for c in region.coordinates))

    def apart(self, difference: Tensor) -> Tensor:
        """Differences `(*batch, d)` of two cells, in cells, the shortest way."""
        turns = [n if closed else math.inf for n, closed in zip(self.shape, self.closed, strict=True)]
        return shortest(difference, torch.tensor(turns, device=difference.device))


def find_peaks(surface: Tensor, grid: Grid, number: int, separation: float) -> tuple[Tensor, Tensor]:
    """The strongest local maxima of a surface.

    A peak is positive and no lower than the up to 3^d - 1 cells around it; connected cells of equal height
    are one peak, or none where one of them has a higher neighbour. Cells at the edge of the grid may be
    peaks; where a coordinate is closed, there is no edge.

    Args:
        surface: `(*batch, C)` real, over the cells.
        grid: of d = 1, 2 or 3 coordinates.
        number: Q, of peaks at most.
        separation: peaks that are closer than this many cells to a stronger one in every coordinate are
            dropped.

    Returns:
        Index of each peak's cell, `(*batch, Q)` int64, strongest first, 0 where absent; and whether it is
        present, `(*batch, Q)` bool.

    Raises:
        InputError: if the grid has other than 1 to 3 coordinates, or another number of cells.
    """
    require(len(grid.shape) in POOL, "grid", grid.shape, "1, 2 or 3 coordinates")
    cells = math.prod(grid.shape)
    require(surface.shape[-1] == cells, "surface", f"{surface.shape[-1]} cells", f"{cells} cells")
    flat = surface.reshape(-1, cells)
    left = torch.where(_is_peak(flat, grid), flat, 0.0)
    axes = [torch.arange(n, device=surface.device) for n in grid.shape]
    coordinate = torch.cartesian_prod(*axes).reshape(cells, -1)
    index, present = [], []
    for _ in range(number):
        height, cell = left.max(-1)
        index.append(torch.where(height > 0, cell, 0))
        present.append(height > 0)
        left = torch.where(close(grid.apart(coordinate - coordinate[cell, None]), separation), 0.0, left)
    shape = (*surface.shape[:-1], number)
    return torch.stack(index, -1).reshape(shape), torch.stack(present, -1).reshape(shape)


def close(difference: Tensor, separation: float) -> Tensor:
    """Whether a difference of two positions is below the separation in every coordinate.

    Args:
        difference: `(*batch, d)`, in cells.
        separation: in cells.

    Returns:
        `(*batch,)` bool.
    """
    # Cells at just the separation count as apart, whatever the rounding of their centres.
    return (difference.abs() < separation - 1e-3).all(-1)


def _is_peak(surface: Tensor, grid: Grid) -> Tensor:
    """Whether each cell is a peak or stands for one of equal cells, `(B, C)` to `(B, C)` bool."""

    def highest(values: Tensor) -> Tensor:
        """Largest value among a cell and its neighbours."""
        around = values.reshape(-1, 1, *grid.shape)
        if any(grid.closed):
            ends = [int(closed) for closed in reversed(grid.closed) for _ in range(2)]
            around = functional.pad(around, ends, mode="circular")
        padding = [int(not closed) for closed in grid.closed]
        return POOL[len(grid.shape)](around, kernel_size=3, stride=1, padding=padding).reshape(values.shape)

    candidate = (surface > 0) & (surface >= highest(surface))
    # A candidate beside an equal cell that is none lies on a shoulder, and so do the equal ones beside it.
    while True:
        shoulder = candidate & (highest(torch.where(candidate, -torch.inf, surface)) >= surface)
        if not bool(shoulder.any()):
            break
        candidate = candidate & ~shoulder
    # Adjacent candidates are equally high; the one of the largest label, spread over them all, is kept.
    label = torch.arange(1, surface.shape[-1] + 1, dtype=surface.dtype, device=surface.device)
    spread = torch.where(candidate, label, 0.0)
    while True:
        wider = torch.where(candidate, highest(spread), 0.0)
        if bool((wider == spread).all()):
            return candidate & (spread == label)
        spread = wider
