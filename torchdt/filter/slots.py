"""Slots of potential objects: order, selection and union."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.trees import tree_map
from torchdt.filter.bp.beliefs import Beliefs, strongest_first
from torchdt.filter.state import Objects


class Placed(NamedTuple):
    """Objects with the particles on which this step's messages are computed.

    Attributes:
        objects: of batch `(*batch, N)`, predicted weights.
        response: `(*batch, N, I, P, M)` complex.
        beliefs: current beliefs.
    """

    objects: Objects
    response: Tensor
    beliefs: Beliefs


def strongest_slots(objects: Objects) -> Tensor:
    """Slot indices by decreasing `r E[gamma]` of what transmits, empty ones last, `(*batch, N)` int64."""
    strength = (objects.existence * objects.transmission)[..., None] * objects.mean_power
    return strongest_first(torch.where(objects.log_odds.isfinite()[..., None], strength, -torch.inf))


def take_rows(tensor: Tensor, index: Tensor) -> Tensor:
    """Slots of a tensor: `(*batch, N, ...)` at `(*batch, N')` indices, `(*batch, N', ...)`."""
    at = index.reshape(*index.shape, *(1 for _ in range(tensor.ndim - index.ndim)))
    return tensor.gather(index.ndim - 1, at.expand(*index.shape, *tensor.shape[index.ndim :]))


def take_slots(objects: Objects, index: Tensor) -> Objects:
    """Objects at `(*batch, N')` slot indices of `(*batch, N)`."""
    return tree_map(lambda t: take_rows(t, index), objects)


def fit_slots(objects: Objects, template: Objects) -> Objects:
    """Objects by decreasing strength in as many slots as the template has, the rest of them empty.

    Args:
        objects: `(*batch, N')`, of which no more exist than there are slots.
        template: `(*batch, N)`, filling for the empty slots.
    """
    num_slots, dim = template.log_odds.shape[-1], template.log_odds.ndim - 1
    blank = template._replace(
        log_odds=torch.full_like(template.log_odds, -torch.inf), label=torch.zeros_like(template.label)
    )
    padded = Objects(*join(objects, blank, dim))
    return take_slots(padded, strongest_slots(padded)[..., :num_slots])


def join(first: Sequence[Tensor], second: Sequence[Tensor], dim: int) -> list[Tensor]:
    """Concatenate tuples of tensors field by field."""
    return [torch.cat([a, b], dim) for a, b in zip(first, second, strict=True)]


def join_beliefs(known: Beliefs, new: Beliefs) -> Beliefs:
    """Beliefs about two groups of objects as one; the noise is that of the first."""
    dim = known.objects.log_odds.ndim - 1
    parts = (known.diffuse, new.diffuse)
    diffuse = [part for part in parts if part is not None]
    return known._replace(
        objects=type(known.objects)(*join(known.objects, new.objects, dim)),
        moment=torch.cat([known.moment, new.moment], dim),
        strength=torch.cat([known.strength, new.strength], dim),
        power=torch.cat([known.power, new.power], dim),
        diffuse=torch.cat(diffuse, dim) if diffuse else None,
    )
