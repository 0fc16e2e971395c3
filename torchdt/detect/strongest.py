"""The cell where one more object raises the likelihood most, found without testing every cell exactly.

Most of what a cell costs is `s = a^H Sigma^-1 a`. Where the background is noise and a few strong objects, few
eigenvalues mu of `Sigma^-1` lie much below its bulk, and with their eigenvectors u

    `s >= mu_bulk |a|^2 - sum_k (mu_bulk - mu_k) |u_k^H a|^2`

bounds the log-likelihood ratio of every cell from above, tightly. Only cells whose bound reaches the exact
value of the most promising one are tested: the result is that of testing all.
"""

import torch
from torch import Tensor

from torchdt.bp.rank_one import Whitener, peak_log_likelihood_ratio, squared_products, statistics
from torchdt.detect.dictionary import Dictionary, likelihood_surface

BULK = 1.05
"""Eigenvalues of the inverse background less than this factor below the largest need no eigenvector."""

BLOCK = 1_000_000
"""Numbers of the largest tensor, to stay within the cache of a processor."""


def strongest_cell(dictionary: Dictionary, whitener: Whitener, among: Tensor) -> tuple[Tensor, Tensor]:
    """The largest value of `likelihood_surface`, `(*batch,)`, and its cell, `(*batch,)` int64.

    Args:
        dictionary: responses on the grid.
        whitener: of the background, batch `(*batch,)`.
        among: `(*batch,)` bool, the sequences to look at; others get minus infinity and cell 0.
    """
    rows = among.flatten().nonzero().squeeze(-1)
    flat = Whitener(*(t.reshape(-1, *t.shape[among.ndim :])[rows] for t in whitener))
    if dictionary.response.ndim > 3 and len(rows) < among.numel():
        dictionary = dictionary._replace(response=dictionary.response[rows], energy=dictionary.energy[rows])
    found = _strongest(dictionary, flat) if len(rows) else (flat.num_snapshots.sum(-1), rows)
    nowhere = (found[0].new_full((among.numel(),), -torch.inf), rows.new_zeros(among.numel()))
    score, cell = (t.index_copy(0, rows, f).reshape(among.shape) for t, f in zip(nowhere, found, strict=True))
    return score, cell


def _strongest(dictionary: Dictionary, flat: Whitener) -> tuple[Tensor, Tensor]:
    """The same for all of B sequences."""
    num_sensors = flat.projection.shape[-2]
    root = flat.projection[..., :num_sensors]
    level, vector = torch.linalg.eigh(root @ root.mH)
    few = int((level * BULK < level[..., -1:]).sum(-1).max())
    if few > num_sensors // 2:
        score, cell = likelihood_surface(dictionary, flat).max(-1)
        return score, cell
    bulk = level[..., few]
    strong = vector[..., :few] * (bulk[..., None] - level[..., :few]).clamp_min(0).sqrt()[..., None, :]
    columns = torch.cat([strong, flat.projection[..., num_sensors:]], -1)
    # Rounding must not lift the bound on s above s.
    slack = 100 * torch.finfo(level.dtype).eps
    floor = (level[..., 0] * (1 - slack)).clamp_min(0)
    bound = _bounds(dictionary, columns, few, flat.num_snapshots, bulk * (1 - slack), floor)
    best = [_test(dictionary, flat, b, row) for b, row in enumerate(bound)]
    score, cell = (torch.stack(t) for t in zip(*best, strict=True))
    return score, cell


def _bounds(
    dictionary: Dictionary, columns: Tensor, few: int, J: Tensor, bulk: Tensor, floor: Tensor
) -> Tensor:
    """Upper bounds of the surface, `(B, C)`.

    Args:
        columns: `(B, I, M, few + R)` complex, what the responses are multiplied by.
        few: number of those of s.
        J, bulk, floor: `(B, I)` number of snapshots; that of which they are taken off; smallest eigenvalue.
    """
    num, num_tones, _, width = columns.shape
    block = max(1, BLOCK // (2 * num * num_tones * width))
    bounds = []
    for response, energy in zip(
        dictionary.response.split(block, -2), dictionary.energy.split(block, -1), strict=True
    ):
        if response.ndim == 3:  # one dictionary for all sequences, which is then read only once
            squares = squared_products(columns.permute(1, 2, 0, 3).flatten(-2), response)
            squares = squares.unflatten(-2, (num, 2 * width)).transpose(0, 1)
        else:
            squares = squared_products(columns, response)
        s, q = (t.sum(-2) for t in squares.split([2 * few, 2 * (width - few)], -2))
        lowest = torch.maximum(bulk[..., None] * energy - s, floor[..., None] * energy)
        bounds.append(peak_log_likelihood_ratio(J[..., None], lowest, q)[0].sum(-2))
    return torch.cat(bounds, -1)


def _test(dictionary: Dictionary, whitener: Whitener, index: int, bound: Tensor) -> tuple[Tensor, Tensor]:
    """Largest exact value and its cell, of sequence `index`."""
    projection, J = whitener.projection[index], whitener.num_snapshots[index]
    response = dictionary.response if dictionary.response.ndim == 3 else dictionary.response[index]

    def exact(cells: Tensor) -> Tensor:
        s, q = statistics(Whitener(projection, J), response[:, cells])
        return peak_log_likelihood_ratio(J[..., None], s, q)[0].sum(-2)

    promising = exact(bound.argmax(-1, keepdim=True))
    cells = (bound >= promising * (1 - 1e-4)).nonzero().squeeze(-1)
    score, at = exact(cells).max(-1)
    return score, cells[at]
