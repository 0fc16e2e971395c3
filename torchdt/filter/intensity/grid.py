"""Hypotheses about an undetected object: its cell, what its state has beside the position, and its level."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchdt.filter.intensity.transport import Kernel, kernel, node_matrix
from torchdt.model.model import Model
from torchdt.model.motion.base import Motion
from torchdt.model.region import Region

ENOUGH = 0.25
"""Cells by which the objects of a node may drift apart in one step: what stays together for some steps."""

SAMPLES = 4096
"""Quasi-random states of new objects, by which the grid of their rates is laid."""


class Hypotheses(NamedTuple):
    """A grid of cells C, nodes V and levels L.

    Attributes:
        axes: number of nodes along each entry of a state behind the position.
        node: `(V, E)` these entries.
        edge: `(E,)` width of a node.
        node_share: `(V,)` of new objects.
        level: `(L,)` ratio of signal to noise of one tone and snapshot behind the array, in the mean of all
            cells.
        born: `(C,)` whether an object can be in a cell.
    """

    axes: tuple[int, ...]
    node: Tensor
    edge: Tensor
    node_share: Tensor
    level: Tensor
    born: Tensor


class Transition(NamedTuple):
    """What one step makes of an intensity.

    Attributes:
        cells: along each coordinate.
        nodes: `(*batch, V, V')`.
        levels: `(*batch, L, L')`.
    """

    cells: list[Kernel]
    nodes: Tensor
    levels: Tensor


def lay_grid(region: Region, motion: Motion, step_s: float, level: Tensor, most: int) -> Hypotheses:
    """Choose the nodes of a region: those that keep an object in its cells as long as can be.

    The axis along which the objects of a node drift apart fastest is divided further while there is room.

    Args:
        region: region of interest.
        motion: of objects.
        step_s: time step in seconds.
        level: `(L,)`.
        most: largest number of hypotheses, C L V.
    """
    d, like = region.num_coordinates, region.low
    number = motion.num_extra(d)
    # The grid is one for all sequences; their numbers may differ.
    motion = motion.select([0])
    if number == 0:
        none = like.new_zeros(1, 0)
        return Hypotheses((), none, none[0], like.new_ones(1), level, region.is_birth_cell)
    uniform = SobolEngine(number).draw(SAMPLES + 1)[1:].to(like)
    middle = (region.low + region.high) / 2
    extra = motion.newborn(region, middle.expand(SAMPLES, d), torch.special.ndtri(uniform))[:, d:]
    low, high = extra.amin(0), extra.amax(0)
    room = most // (math.prod(region.grid_shape) * len(level))
    axes = _divide(_drift(region, motion, step_s, low, high), room)
    edge = (high - low) / like.new_tensor(axes)
    centres = [
        lo + e * (torch.arange(n, device=like.device) + 0.5) for lo, e, n in zip(low, edge, axes, strict=True)
    ]
    node = torch.cartesian_prod(*centres).reshape(-1, number).to(like)
    index = ((extra - low) / edge.clamp_min(torch.finfo(edge.dtype).tiny)).long()
    flat = torch.zeros_like(index[:, 0])
    for along, n in zip(index.unbind(-1), axes, strict=True):
        flat = flat * n + along.clamp(0, n - 1)
    share = torch.bincount(flat, minlength=len(node)).to(like) / SAMPLES
    return Hypotheses(axes, node, edge, share, level, region.is_birth_cell)


def _drift(region: Region, motion: Motion, step_s: float, low: Tensor, high: Tensor) -> list[float]:
    """How far apart one step takes the ends of each axis, in cells."""
    d, number = region.num_coordinates, len(low)
    middle = (region.low + region.high) / 2
    ends = ((low + high) / 2).repeat(2, number, 1)
    for end, value in enumerate((low, high)):
        ends[end].diagonal().copy_(value)
    state = torch.cat([middle.expand(2, number, d), ends], -1)
    still = torch.zeros(2, number, d + number, d + number, dtype=low.dtype, device=low.device)
    moved, _ = motion.moments(state, still, step_s)
    return [float(x) for x in ((moved[1] - moved[0])[:, :d].abs() / region.cell).amax(-1)]


def _divide(drift: list[float], room: int) -> tuple[int, ...]:
    axes = [1 for _ in drift]
    while True:
        axis = max(range(len(axes)), key=lambda j: drift[j] / axes[j])
        larger = [n + (j == axis) for j, n in enumerate(axes)]
        if math.prod(larger) > room or drift[axis] / axes[axis] < ENOUGH:
            return tuple(axes)
        axes = larger


def transition(
    grid: Hypotheses, region: Region, model: Model, step_s: float, batch: torch.Size
) -> Transition:
    """One step of the motion and of the powers, between the hypotheses; for each sequence of a batch.

    What a motion does is taken in the middle of the region. Inside a node states are spread evenly.
    """
    d, like = region.num_coordinates, region.low
    motion, number = model.motion, grid.node.shape[-1]
    middle = ((region.low + region.high) / 2).expand(len(grid.node), d)
    state = torch.cat([middle, grid.node], -1).expand(*batch, -1, -1)
    still = like.new_zeros(d + number, d + number)
    spread = torch.cat([like.new_zeros(d), grid.edge.square() / 12]).diag_embed()
    mean, covariance = motion.moments(state, spread.expand(*state.shape[:-1], -1, -1), step_s)
    shift = (mean[..., :d] - middle) / region.cell
    variance = covariance.diagonal(dim1=-2, dim2=-1)[..., :d] / region.cell.square()
    cells = [kernel(shift[..., j], variance[..., j]) for j in range(d)]
    level = model.power.level_transition(grid.level)
    if number == 0:
        return Transition(cells, like.new_ones(1, 1), level)
    mean, covariance = motion.moments(state, still.expand(*state.shape[:-1], -1, -1), step_s)
    shift = (mean[..., d:] - grid.node) / grid.edge
    variance = covariance.diagonal(dim1=-2, dim2=-1)[..., d:] / grid.edge.square()
    along = [kernel(shift[..., j], variance[..., j]) for j in range(number)]
    return Transition(cells, node_matrix(along, grid.axes), level)
