"""How an intensity on a grid moves in one step: by few weights along each axis."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import one_hot, pad

WIDEST = 50.0
"""Largest variance of one step, squared cells: what spreads over thirty cells may as well be anywhere."""


class Kernel(NamedTuple):
    """Weights that carry V rows along an axis.

    Attributes:
        offset: `(V,)` whole cells that each row moves.
        weight: `(*batch, V, 2 m + 1)` of the cells around, from `offset - m` to `offset + m`.
    """

    offset: list[int]
    weight: Tensor


def kernel(shift: Tensor, variance: Tensor) -> Kernel:
    """Weights of the given mean, and of the given variance or the least that cells can have.

    A mean f of the way between two cells has a variance of `f (1 - f)` at least: linear interpolation.
    There is no more than `WIDEST` of it. Wide kernels are narrow ones of three weights applied m times.

    Args:
        shift: `(*batch, V)` mean in cells.
        variance: `(*batch, V)` in squared cells.
    """
    variance, whole = variance.expand_as(shift).clamp_max(WIDEST), shift.detach().round()
    # As often as each row needs, whatever the others do.
    times = (2 * variance.detach()).ceil().clamp_min(1)
    mean = (shift - whole) / times
    square = torch.maximum(variance / times, mean.abs() * (1 - mean.abs())) + mean.square()
    once = torch.stack([(square - mean) / 2, 1 - square, (square + mean) / 2], -1)
    weight = once
    for done in range(1, int(times.max())):
        wide = [pad(weight * once[..., k : k + 1], (k, 2 - k)) for k in range(3)]
        weight = torch.where((done < times)[..., None], wide[0] + wide[1] + wide[2], pad(weight, (1, 1)))
    offset = whole.reshape(-1, whole.shape[-1]).mean(0).round()
    ahead = (whole - offset).long()
    # Sequences whose objects move further than those of others.
    if reach := int(ahead.abs().max()):
        weight = pad(weight, (2 * reach, 2 * reach))
        index = torch.arange(reach, weight.shape[-1] - reach, device=ahead.device) - ahead[..., None]
        weight = weight.gather(-1, index)
    return Kernel([int(n) for n in offset.tolist()], weight)


def carry(values: Tensor, offset: int, weight: Tensor, dim: int, closed: bool) -> Tensor:
    """Move values along one axis; what passes an end is lost.

    Args:
        values: `(*batch, ...)`.
        offset: whole cells.
        weight: `(*batch, 2 m + 1)`.
        dim: of the axis, negative.
        closed: whether the axis goes round.
    """
    reach, size = weight.shape[-1] // 2, values.shape[dim]
    wide = weight.reshape(*weight.shape[:-1], *(1 for _ in values.shape[weight.ndim - 1 :]), -1)
    total = torch.zeros_like(values)
    for k in range(-reach, reach + 1):
        move, factor = offset + k, wide[..., reach + k]
        if closed:
            total = total + torch.roll(values, move, dim) * factor
        elif abs(move) < size:
            length = size - abs(move)
            part = values.narrow(dim, max(0, -move), length)
            total.narrow(dim, max(0, move), length).addcmul_(part, factor)
    return total


def node_matrix(kernels: list[Kernel], shape: tuple[int, ...]) -> Tensor:
    """Transition between the nodes of a grid, `(*batch, V, V')`; what passes an end stays there.

    Args:
        kernels: of all V nodes along each axis.
        shape: of the grid.
    """
    device = kernels[0].weight.device
    axes = (torch.arange(n, device=device) for n in shape)
    index = torch.cartesian_prod(*axes).reshape(-1, len(shape))
    matrix: Tensor | None = None
    for axis, (moves, num) in enumerate(zip(kernels, shape, strict=True)):
        reach = moves.weight.shape[-1] // 2
        offset = torch.tensor(moves.offset, device=device)[:, None]
        steps = offset + torch.arange(-reach, reach + 1, device=device)
        to = (index[:, axis, None] + steps).clamp(0, num - 1)
        along = one_hot(to, num).to(moves.weight)  # (V, 2 m + 1, num)
        part = (moves.weight[..., None] * along).sum(-2)  # (*batch, V, num)
        part = part[..., index[:, axis]]
        matrix = part if matrix is None else matrix * part
    assert matrix is not None, "a grid has an axis"
    return matrix
