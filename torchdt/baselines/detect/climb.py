"""Search for a peak between the points of a grid."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchdt.core.trees import take
from torchdt.model.existence import drop_outside
from torchdt.model.region import Region

LEVELS = 6
"""Grids of the search; the steps are half a birth cell, a quarter, ..., 1/64."""


@torch.no_grad()
def climb(score: Callable[[Tensor], Tensor], centre: Tensor, region: Region) -> Tensor:
    """Best position within one birth cell around a centre, and inside the region.

    A pattern search (Hooke and Jeeves 1961): the best of a grid of 5 points along each coordinate becomes the
    centre of the next one, of half the step. Among equals the one closest to the centre is best, so that it
    stays where nothing is to be gained. It draws no random numbers.

    Args:
        score: maps positions `(*batch, S, d)` to `(*batch, S)`; minus infinity forbids a position.
        centre: `(*batch, d)` in the box of the region.
        region: limits and cells.

    Returns:
        `(*batch, d)`, with a score no lower than the centre's. A centre outside the region stays where it is
        if nothing around it is inside.
    """
    low = torch.maximum(centre - region.cell, region.lower_end)[..., None, :]
    high = torch.minimum(centre + region.cell, region.upper_end)[..., None, :]
    axis = torch.arange(-2, 3, dtype=centre.dtype, device=centre.device)
    offset = torch.cartesian_prod(*[axis] * centre.shape[-1]).reshape(-1, centre.shape[-1])
    offset = offset[offset.square().sum(-1).argsort(stable=True)] * region.cell
    for level in range(1, LEVELS + 1):
        points = torch.clamp(centre[..., None, :] + 0.5**level * offset, low, high)
        centre = take(points, drop_outside(points, score(points), region).argmax(-1))
    return region.wrap(centre)
