"""From the intensity to potential objects, and back."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchdt.core.trees import tree_map
from torchdt.core.weights import normalise
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.state import Objects
from torchdt.model.power.base import PowerModel

if TYPE_CHECKING:
    from torchdt.filter.intensity.settings import Intensity
    from torchdt.filter.intensity.undetected import Undetected


def neighbourhood(dictionary: Dictionary, cell: Tensor, settings: Intensity) -> Tensor:
    """The cells that the array hardly tells from one, wherever they lie, `(*batch, C)` bool.

    Those are alike of whose responses' energy another explains enough, in the mean over tones.

    Args:
        dictionary: responses on the grid of cells.
        cell: `(*batch,)` int64.
        settings: of the intensity.
    """
    response, energy = dictionary.response, dictionary.energy
    if response.ndim == 3:
        own = response[:, cell].movedim(0, -2)
    else:  # a field for each sequence
        more = [1] * (cell.ndim - 1)
        sequence = torch.arange(len(response), device=cell.device).reshape(-1, *more)
        own = response.movedim(-2, 1)[sequence, cell]
        response = response.reshape(len(response), *more, *response.shape[1:])
        energy = energy.reshape(len(energy), *more, *energy.shape[1:])
    product = (response @ own.conj()[..., None]).squeeze(-1).abs().square()
    norm = energy * torch.linalg.vector_norm(own, dim=-1).square()[..., None]
    return (product / norm.clamp_min(torch.finfo(norm.dtype).tiny)).mean(-2) >= settings.alike


def candidate(undetected: Undetected, intensity: Tensor) -> tuple[Tensor, Tensor]:
    """Cells around the most probable one, `(*batch, C)` bool, and the odds of an object there."""
    cells = intensity.sum((-3, -2))
    near = neighbourhood(undetected.dictionary, cells.argmax(-1), undetected.settings)
    return near, (cells * near).sum(-1)


def promote(
    undetected: Undetected,
    intensity: Tensor,
    near: Tensor,
    power: Tensor,
    power_model: PowerModel,
    power_max: Tensor,
    power_points: int,
    draws: Tensor,
) -> Objects:
    """A potential object with the odds, states and powers of a neighbourhood, batch `(*batch, 1)`.

    Args:
        undetected: what the intensity is of.
        intensity: `(*batch, V, L, C)` after the data.
        near: `(*batch, C)` bool, the neighbourhood; empty for none.
        power: `(*batch, I, G)` of the tones' levels.
        power_model: of the object's powers.
        power_max: `(*batch, I)` upper limit of powers.
        power_points: G' of their support.
        draws: `(*batch, P, D)` standard normal: where in its cell and node each particle is.
    """
    grid, region = undetected.grid, undetected.region
    within = intensity * near[..., None, None, :]
    number = draws.shape[-2]
    states = within.sum(-2).flatten(-2)  # (*batch, V C)
    end = states.double().cumsum(-1)
    along = (torch.arange(number, dtype=end.dtype, device=end.device) + 0.5) / number
    index = torch.searchsorted(end, along * end[..., -1:]).clamp_max(states.shape[-1] - 1)
    node, cell = index // near.shape[-1], index % near.shape[-1]
    uniform, d = torch.special.ndtr(draws) - 0.5, region.num_coordinates
    position = undetected.dictionary.points[cell] + uniform[..., :d] * region.cell
    position = position.clamp(region.lower_end, region.upper_end)
    extra = grid.node[node] + uniform[..., d:] * grid.edge
    state = torch.cat([position, extra], -1)
    log_weight = torch.full_like(state[..., 0], -math.log(number))
    level, odds = within.sum((-3, -1)), within.sum((-3, -2, -1))
    support = _powers(level, power, undetected.settings, power_model, power_max, power_points)
    # Where there is none the logarithm has no derivative.
    log_odds = torch.where(odds > 0, torch.where(odds > 0, odds, 1.0).log(), -torch.inf)
    label = torch.zeros_like(odds, dtype=torch.int64)
    one = Objects(state, log_weight, *support, log_odds, label, torch.ones_like(log_weight))
    return tree_map(lambda t: t.unsqueeze(odds.ndim), one)


def _powers(
    level: Tensor, power: Tensor, settings: Intensity, model: PowerModel, maximum: Tensor, num_points: int
) -> tuple[Tensor, Tensor]:
    """Support and log-weights `(*batch, I, G')` of the tones' powers, from weights `(*batch, L)`."""
    _, share = settings.tone_levels(level.new_ones(level.shape[-1]))
    total = level.sum(-1, keepdim=True)
    tone = torch.where(total > 0, level, 1.0)
    tone = (tone / tone.sum(-1, keepdim=True)) @ share
    silent, heard = tone[..., None, :1], tone[..., None, 1:]
    centre = (heard / heard.sum(-1, keepdim=True) * power.log()).sum(-1).exp()
    support, _ = model.newborn(torch.minimum(centre, maximum), maximum, num_points)
    # Between two levels the logarithm is spread linearly.
    distance = (support.log()[..., None] - power.log()[..., None, :]).abs() / math.log(settings.step)
    weight = ((1 - distance).clamp_min(0) * heard[..., None, :]).sum(-1)
    lowest = torch.zeros_like(weight)
    lowest[..., 0] = 1
    weight = weight / weight.sum(-1, keepdim=True).clamp_min(1e-30) * (1 - silent) + silent * lowest
    return support, normalise(weight.clamp_min(1e-12).log())[0]


def give_back(
    undetected: Undetected, intensity: Tensor, objects: Objects, dropped: Tensor, power: Tensor
) -> Tensor:
    """The intensity with what dropped objects leave: `(*batch, V, L, C)`.

    Args:
        undetected: what the intensity is of.
        intensity: after the step.
        objects: after the step, batch `(*batch, N)`.
        dropped: `(*batch, N)` bool.
        power: `(*batch, I, G)` of the tones' levels.
    """
    if not bool(dropped.any()):
        return intensity
    grid, region = undetected.grid, undetected.region
    num_levels, num_cells = intensity.shape[-2:]
    odds = torch.where(dropped, objects.log_odds, -torch.inf).exp()
    mass = objects.log_weight.exp() * odds[..., None]  # (*batch, N, P)
    mass = torch.where(region.contains(objects.state), mass, 0.0)
    d = region.num_coordinates
    node = torch.zeros_like(mass, dtype=torch.int64)
    for j, n in enumerate(grid.axes):
        low = grid.node[0, j] - grid.edge[j] / 2
        along = ((objects.state[..., d + j] - low) / grid.edge[j]).floor().long()
        node = node * n + along.clamp(0, n - 1)
    # The level whose power is that of the tones, in the mean of their logarithms.
    mean_power = objects.mean_power.clamp_min(torch.finfo(power.dtype).tiny)  # there may be none
    ratio = (mean_power / power[..., None, :, 1]).log().mean(-1)
    level = (ratio / math.log(undetected.settings.step)).round().long().clamp(0, num_levels - 1)
    index = (node * num_levels + level[..., None]) * num_cells + region.cell_of(objects.state[..., :d])
    flat = intensity.flatten(-3).scatter_add(-1, index.flatten(-2), mass.flatten(-2).to(intensity))
    return flat.unflatten(-1, intensity.shape[-3:])
