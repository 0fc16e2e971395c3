"""Responses on a grid, and surfaces over it: Bartlett and likelihood ratio."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.core.memory import require_memory
from torchdt.field.base import BaseField, Field, as_field, of_each
from torchdt.filter.bp.rank_one import Whitener, peak_log_likelihood_ratio, statistics
from torchdt.model.measurement import Measurement
from torchdt.model.region import Region


class Dictionary(NamedTuple):
    """Responses at the centres of all cells of the region's grid.

    Attributes:
        points: `(C, d)` positions.
        response: `(I, C, M)` complex, or `(B, I, C, M)` with a field per sequence; zero, so that nothing is
            found there, for cells in which no object can be born.
        energy: `|a|^2`, `(I, C)` or `(B, I, C)`.
    """

    points: Tensor
    response: Tensor
    energy: Tensor


def build_dictionary(field: Field, region: Region) -> Dictionary:
    """Evaluate a field on the region's grid of cells, at the rates in the middle of the region's.

    Raises:
        InputError: where what the field returns has the wrong shape or type or is not finite, or the
            responses do not fit into the memory.
    """
    field, points = as_field(field), region.cell_centres()
    found = f"{len(points)} cells of {field.num_tones} tones and {field.num_sensors} sensors"
    numbers = 2 * of_each(field, points)[..., 0].numel() * field.num_tones * field.num_sensors
    twice = 2 * numbers * points.dtype.itemsize  # joined of parts
    require_memory(twice, points.device, "scenario.coordinates", found)
    with torch.no_grad():
        parts = [_responses(field, region.complete(part)) for part in points.split(4096)]
    response = torch.cat(parts, -2).contiguous()
    outside = ~region.is_birth_cell
    response.masked_fill_(outside[:, None], 0.0)
    if not response.is_meta:
        _check_finite(response, region, points)
    return Dictionary(points, response, torch.linalg.vector_norm(response, dim=-1).square())


def _responses(field: BaseField, state: Tensor) -> Tensor:
    """`(I, C, M)`, or `(B, I, C, M)` with a field per sequence, at states `(C, D)` that all share."""
    state = of_each(field, state)
    response = field(state)
    found: object = type(response).__name__
    if isinstance(response, Tensor):
        found = f"shape {tuple(response.shape)} and type {response.dtype}"
    shape, dtype = (*state.shape[:-1], field.num_tones, field.num_sensors), state.dtype.to_complex()
    expected, states = f"shape {shape} and type {dtype}", f"to states of shape {tuple(state.shape)}"
    require(found == expected, "field", f"a response of {found}", f"{expected} {states}")
    return response.transpose(-3, -2)


def _check_finite(response: Tensor, region: Region, points: Tensor) -> None:
    wrong = (~response.isfinite().all(-1)).reshape(-1, len(points)).any(0)
    if bool(wrong.any()):
        names = [c.name for c in region.coordinates]
        place = dict(zip(names, points[wrong][0].tolist(), strict=True))
        found = f"a response that is not finite in {int(wrong.sum())} cells, the first at {place}"
        raise InputError.of_key("field", found, "finite numbers wherever there can be an object")


def bartlett_surface(dictionary: Dictionary, measurement: Measurement) -> Tensor:
    """Conventional beamformer: `mean_i a^H S a / (|a|^2 tr S)`, `(*batch, C)` in [0, 1].

    Each tone counts alike. Tones without data are left out.
    """
    response = dictionary.response * measurement.present[..., None, :]
    output = (response.conj() @ measurement.factor).abs().square().sum(-1)
    norm = response.abs().square().sum(-1)
    energy = measurement.factor.abs().square().sum((-2, -1))[..., None]
    tiny = torch.finfo(output.dtype).tiny
    observed = (measurement.num_snapshots > 0).to(output.dtype)[..., None]
    share = output / (norm * energy).clamp_min(tiny)
    return (observed * share).sum(-2) / observed.sum(-2).clamp_min(1.0)


def likelihood_surface(dictionary: Dictionary, whitener: Whitener) -> Tensor:
    """Log-likelihood ratio of one more object in each cell, at the best power of each tone, `(*batch, C)`.

    This is the score of multi-frequency matching pursuit with the residual whitened by everything that
    is already explained, instead of projected off it.
    """
    batch = whitener.num_snapshots.shape[:-1]
    responses = dictionary.response.expand(*batch, *dictionary.response.shape[-3:])
    flat = (t.flatten(0, len(batch) - 1) if batch else t[None] for t in (*whitener, responses))
    # One sequence at a time: the projected dictionary is the largest tensor of all.
    surfaces = []
    for projection, J, response in zip(*flat, strict=True):
        s, q = statistics(Whitener(projection, J), response)
        surfaces.append(peak_log_likelihood_ratio(J[..., None], s, q)[0].sum(-2))
    return torch.stack(surfaces).reshape(*batch, -1)
