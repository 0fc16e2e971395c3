"""Mode functions between the depths of their tables."""

import torch
from torch import Tensor
from torch.nn import functional

from torchdt.field.waveguide.modes import ModeTable


def interleave(table: ModeTable, device: torch.device | str | None) -> Tensor:
    """Mode functions and slopes times the grid step, row by row in turn, `(2 G, N)` float64."""
    step = table.depth[1] - table.depth[0]
    pair = torch.stack([torch.tensor(rows, device=device) for rows in (table.psi, table.slope * step)], dim=1)
    return pair.flatten(0, 1)


def interpolate_modes(shapes: Tensor, fraction: Tensor) -> Tensor:
    """Cubic Hermite interpolation, once continuously differentiable.

    Args:
        shapes: `(2 G, N)` of `interleave`.
        fraction: `(S,)` depths as fractions of the grid's depth, 0 to 1.

    Returns:
        `(S, N)` mode functions.
    """
    rows, weights = hermite_rows(len(shapes) // 2 - 1, fraction)
    return functional.embedding_bag(rows, shapes, per_sample_weights=weights, mode="sum")


def hermite_rows(num_cells: int, fraction: Tensor) -> tuple[Tensor, Tensor]:
    """Rows of a table of `num_cells + 1` depths mixed at fractions `(S,)`, and how: `(S, 4)` each."""
    position = fraction * num_cells
    cell = position.detach().long().clamp(0, num_cells - 1)
    t = position - cell
    u = 1 - t
    weights = torch.stack([(1 + 2 * t) * u * u, t * u * u, (1 + 2 * u) * t * t, -u * t * t], dim=-1)
    return 2 * cell[:, None] + torch.arange(4, device=cell.device), weights
