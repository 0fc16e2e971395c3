"""Responses on a grid, and surfaces over it: Bartlett and likelihood ratio."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.bp.rank_one import Whitener, peak_log_likelihood_ratio, statistics
from torchdt.field.base import Field
from torchdt.field.stacked import StackedField
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
    """Evaluate a field on the region's grid of cells."""
    points = region.cell_centres()
    if isinstance(field, StackedField):
        response = torch.stack([_responses(f, points) for f in field.fields])
    else:
        response = _responses(field, points)
    response.masked_fill_(~region.is_birth_cell[:, None], 0.0)
    return Dictionary(points, response, torch.linalg.vector_norm(response, dim=-1).square())


def _responses(field: Field, points: Tensor) -> Tensor:
    with torch.no_grad():
        return torch.cat([field(part).transpose(0, 1) for part in points.split(4096)], dim=1).contiguous()


def bartlett_surface(dictionary: Dictionary, measurement: Measurement) -> Tensor:
    """Conventional beamformer: `mean_i a^H S a / (|a|^2 tr S)`, `(*batch, C)` in [0, 1].

    Each tone counts alike. Tones without data are left out.
    """
    response = dictionary.response * measurement.present[..., None, :]
    output = (response.conj() @ measurement.factor).abs().square().sum(-1)
    norm = response.abs().square().sum(-1)
    energy = measurement.factor.abs().square().sum((-2, -1))[..., None]
    tiny = torch.finfo(output.dtype).tiny
    heard = (measurement.num_snapshots > 0).to(output.dtype)[..., None]
    share = output / (norm * energy).clamp_min(tiny)
    return (heard * share).sum(-2) / heard.sum(-2).clamp_min(1.0)


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
