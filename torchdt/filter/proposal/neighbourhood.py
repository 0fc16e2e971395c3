"""Where a new object may be: a box around its pick that holds the likelihood, and no place for two.

Objects are born anywhere in the region with the density `mu_B` over its cells. Of that density a potential
object takes what lies where its likelihood is: the box starts as one cell and doubles, coordinate by
coordinate, until little of the likelihood is left near its sides. Boxes may overlap, and of two picks one may
be the other once more: of the places where picks see their objects, one that is in several belongs to the
smallest, or an object would be counted several times.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchdt.core.importance import Box, Gaussian
from torchdt.core.weights import normalise
from torchdt.model.region import Region

OUTER = 0.01
"""Share of the likelihood in the outer half of a box from which on the box doubles."""


def cell_around(centre: Tensor, region: Region) -> Box:
    """A box of one cell around `(*batch, d)`, moved into the region."""
    centre = centre.clamp(region.lower_end + region.cell / 2, region.upper_end - region.cell / 2)
    return Box(centre - region.cell / 2, centre + region.cell / 2)


@torch.no_grad()
def grow(log_likelihood: Callable[[Tensor], Tensor], peak: Tensor, region: Region, rounds: Tensor) -> Box:
    """A box around a peak of a likelihood that holds all but a small part of it.

    Where the likelihood is a Gaussian, a box ends beyond five of its standard deviations. Where it is all
    around, it is one period wide.

    Args:
        log_likelihood: maps positions `(*batch, S, d)` to `(*batch, S)`.
        peak: `(*batch, d)` in the region.
        region: where the box ends at the latest.
        rounds: `(rounds, *batch, S, d)` standard normal draws.
    """
    half = (region.cell / 2).expand_as(peak).clone()
    growing = torch.ones_like(peak, dtype=torch.bool)
    for doubling in range(math.ceil(math.log2(max(region.grid_shape))) + 1):
        points = _spread(_around(peak, half, region), peak, rounds[doubling % len(rounds)])
        log_weight = log_likelihood(points.flatten(-3, -2)).unflatten(-1, points.shape[-3:-1])
        weight = normalise(log_weight)[0].exp()[..., None]
        outer = (points - peak[..., None, None, :]).abs() > half[..., None, None, :] / 2
        growing = growing & ((weight * outer).sum(-2) > OUTER).any(-2)
        if not bool(growing.any()):
            break
        half = torch.where(growing, torch.minimum(2 * half, region.period / 2), half)
    return _around(peak, half, region)


def _spread(box: Box, peak: Tensor, draws: Tensor) -> Tensor:
    """Sets of points `(*batch, 1 + d, S + 1, d)`: all over a box, and along each coordinate through its peak.

    A likelihood that is sharp in one coordinate is missed by points all over the box, however far it reaches
    in another. The peak is part of each set: where all others miss, nothing is outside.
    """
    points, centre = box.sample(draws)[..., None, :, :], peak[..., None, None, :]
    along = torch.eye(peak.shape[-1], dtype=torch.bool, device=peak.device)[:, None]
    sets = torch.cat([points, torch.where(along, points, centre)], -3)
    return torch.cat([centre.expand_as(sets[..., :1, :]), sets], -2)


def _around(peak: Tensor, half: Tensor, region: Region) -> Box:
    return Box(torch.maximum(peak - half, region.lower_end), torch.minimum(peak + half, region.upper_end))


def drop_foreign(position: Tensor, log_weight: Tensor, places: Box, active: Tensor, region: Region) -> Tensor:
    """Take the weight from particles at places that belong to another pick, see above.

    Args:
        position: `(*batch, Q, P, d)`.
        log_weight: `(*batch, Q, P)`.
        places: of batch `(*batch, Q)`.
        active: `(*batch, Q)` bool, the picks that count.
        region: of interest.
    """
    low, high = (corner[..., None, None, :, :] for corner in places)
    points = region.nearest(position[..., None, :], (low + high) / 2)
    holds = ((points >= low) & (points <= high)).all(-1) & active[..., None, None, :]  # (*batch, Q, P, Q)
    edge = (places.high - places.low).clamp_min(torch.finfo(position.dtype).tiny)
    size = edge.log().sum(-1)[..., None, None, :]
    owner = torch.where(holds, size, torch.inf).argmin(-1)
    own = torch.arange(active.shape[-1], device=active.device)[:, None]
    return torch.where(holds.any(-1) & (owner != own), -torch.inf, log_weight)


def place_of(fitted: Gaussian, box: Box) -> Box:
    """Where a pick sees its object: within three deviations of what was fitted to it, in its box.

    The fit is inflated: these are more than four deviations of the likelihood, beyond which there is less of
    an object than evidence can tell.
    """
    reach = 3 * torch.linalg.vector_norm(fitted.tril, dim=-1)
    return Box(torch.maximum(fitted.mean - reach, box.low), torch.minimum(fitted.mean + reach, box.high))


def log_cells(boxes: Box, region: Region) -> Tensor:
    """Logarithm of the number of cells that boxes are worth, `(*batch,)`."""
    return ((boxes.high - boxes.low) / region.cell).log().sum(-1)
