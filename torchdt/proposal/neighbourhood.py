"""Where a new object may be: a box around its pick that holds the likelihood, and no place in two boxes.

Objects are born anywhere in the region with the density `mu_B` over its cells. Of that density a potential
object takes what lies where its likelihood is: the box starts as one cell and doubles, coordinate by
coordinate, until little of the likelihood is left near its sides. A place in the boxes of several picks
belongs to the nearest of these, or one object would be counted several times.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchdt.model.region import Region
from torchdt.particles.adaptive import Box
from torchdt.particles.weights import normalise

OUTER = 0.01
"""Share of the likelihood in the outer half of a box from which on the box doubles."""


def cell_around(centre: Tensor, region: Region) -> Box:
    """A box of one cell around `(*batch, d)`, moved into the region."""
    centre = centre.clamp(region.low + region.cell / 2, region.high - region.cell / 2)
    return Box(centre - region.cell / 2, centre + region.cell / 2)


@torch.no_grad()
def grow(log_likelihood: Callable[[Tensor], Tensor], peak: Tensor, region: Region, rounds: Tensor) -> Box:
    """A box around a peak of a likelihood that holds all but a small part of it.

    Where the likelihood is a Gaussian, a box ends beyond five of its standard deviations.

    Args:
        log_likelihood: maps positions `(*batch, S, d)` to `(*batch, S)`.
        peak: `(*batch, d)` in the region.
        region: where the box ends at the latest.
        rounds: `(rounds, *batch, S, d)` standard normal draws.
    """
    half = (region.cell / 2).expand_as(peak).clone()
    growing = torch.ones_like(peak, dtype=torch.bool)
    for doubling in range(math.ceil(math.log2(max(region.grid_shape))) + 1):
        box = _around(peak, half, region)
        # The peak itself is among the points: where all others miss a sharp likelihood, nothing is outside.
        points = torch.cat([peak[..., None, :], box.sample(rounds[doubling % len(rounds)])], -2)
        weight = normalise(log_likelihood(points))[0].exp()[..., None]
        outer = (points - peak[..., None, :]).abs() > half[..., None, :] / 2
        growing = growing & ((weight * outer).sum(-2) > OUTER)
        if not bool(growing.any()):
            break
        half = torch.where(growing, 2 * half, half)
    return _around(peak, half, region)


def _around(peak: Tensor, half: Tensor, region: Region) -> Box:
    return Box(torch.maximum(peak - half, region.low), torch.minimum(peak + half, region.high))


def drop_foreign(
    position: Tensor, log_weight: Tensor, peaks: Tensor, boxes: Box, active: Tensor, region: Region
) -> Tensor:
    """Take the weight from particles at places that belong to another pick, see above.

    Args:
        position: `(*batch, Q, P, d)` in the boxes of their own picks.
        log_weight: `(*batch, Q, P)`.
        peaks: `(*batch, Q, d)`.
        boxes: of batch `(*batch, Q)`.
        active: `(*batch, Q)` bool, the picks that count.
        region: its cell is the unit of each coordinate.
    """
    points = position[..., None, :]
    low, high, centre = (t[..., None, None, :, :] for t in (*boxes, peaks))
    holds = ((points >= low) & (points <= high)).all(-1) & active[..., None, None, :]
    distance = ((points - centre) / region.cell).square().sum(-1)  # (*batch, Q, P, Q)
    own = torch.eye(peaks.shape[-2], dtype=torch.bool, device=peaks.device)[:, None, :]
    nearest = torch.where(holds | own, distance, torch.inf).argmin(-1)
    mine = torch.arange(peaks.shape[-2], device=peaks.device)[:, None]
    return torch.where(nearest == mine, log_weight, -torch.inf)


def log_cells(boxes: Box, region: Region) -> Tensor:
    """Logarithm of the number of cells that boxes are worth, `(*batch,)`."""
    return ((boxes.high - boxes.low) / region.cell).log().sum(-1)
