"""Exact filter of one object on a grid of bearings and rates (float64): known power, known noise, no births.

Driving noise takes multiples of the rate's spacing, so that every move ends on the grid.
"""

from typing import NamedTuple

import torch
from torch import Tensor

RATE_CELL = 0.05
BEARING_CELL = RATE_CELL / 2


class Grid(NamedTuple):
    """Bearings `(X,)` of the region, rates `(V,)`, driving noise `(Q,)` in multiples of the rate's cell."""

    bearing: Tensor
    rate: Tensor
    steps: Tensor

    @classmethod
    def over(cls, low: float, high: float, rates: tuple[float, float], driving: float) -> "Grid":
        """Cover the region, the rates, and five standard deviations of the driving noise."""

        def multiples(start: float, stop: float, cell: float) -> Tensor:
            return torch.arange(round(start / cell), round(stop / cell) + 1)

        reach = 5 * driving
        bearing = (multiples(low, high, BEARING_CELL)[:-1] + 0.5).double() * BEARING_CELL
        rate = multiples(*rates, RATE_CELL).double() * RATE_CELL
        return cls(bearing, rate, multiples(-reach, reach, RATE_CELL))


def evidence(grid: Grid, start: Tensor, driving: float, survival: Tensor, ratio: Tensor) -> Tensor:
    """Log evidence of every step over that of noise alone, `(K,)`, see `run`."""
    return run(grid, start, driving, survival, ratio)[0]


def run(grid: Grid, start: Tensor, driving: float, survival: Tensor, ratio: Tensor) -> tuple[Tensor, Tensor]:
    """Filter a recording; an object that leaves the region ends.

    Args:
        grid: of bearings X and rates V.
        start: `(X, V)` density before the first move, times existence.
        driving: standard deviation of the driving noise; the time step is one.
        survival: p_s.
        ratio: `(K, X)` likelihood ratio of an object at each bearing.

    Returns:
        Log evidence of every step over that of noise alone, `(K,)`, and the density after it times existence,
        `(K, X, V)`.
    """
    weight = torch.exp(-0.5 * (grid.steps * RATE_CELL / driving) ** 2)
    weight = weight / weight.sum()
    exists, found, densities = start, [], []
    for likelihood in ratio:
        moved = torch.zeros_like(exists)
        for q, share in zip(grid.steps.tolist(), weight, strict=True):
            for v in range(len(grid.rate)):
                to = v + q
                if 0 <= to < len(grid.rate):
                    by = round(2 * grid.rate[v].item() / RATE_CELL) + q
                    moved[:, to] += share * _shift(exists[:, v], by)
        exists = survival * moved
        absent = 1 - exists.sum()
        exists = exists * likelihood[:, None]
        total = absent + exists.sum()
        found.append(total.log())
        exists = exists / total
        densities.append(exists)
    return torch.stack(found), torch.stack(densities)


def _shift(values: Tensor, by: int) -> Tensor:
    """Move along the grid; what passes its end is lost."""
    shifted = torch.zeros_like(values)
    if by >= 0:
        shifted[by:] = values[: len(values) - by]
    else:
        shifted[:by] = values[-by:]
    return shifted
