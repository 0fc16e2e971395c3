"""The cell where one more object raises the likelihood most, found without testing every cell exactly.

The statistics of all cells come from few eigenvectors of the background, see
`torchdt.filter.proposal.cells`, and are a little off. With room for that they bound the log-likelihood ratio
of every cell from above, tightly. Only cells whose bound reaches the largest value of the most promising ones
are tested: the result is that of testing all. So that this holds in floating point too, the bounds make room
for all rounding, theirs and that of the test.
"""

import torch
from torch import Tensor

from torchdt.core.trees import tree_map
from torchdt.filter.bp.rank_one import Whitener, peak_log_likelihood_ratio, statistics
from torchdt.filter.proposal.cells import CellStatistics, cell_statistics, slack
from torchdt.filter.proposal.dictionary import Dictionary

PROMISING = 32
"""Cells tested first, those of the largest bounds: next to strong objects a few bounds are loose."""


def strongest_cell(
    dictionary: Dictionary,
    whitener: Whitener,
    among: Tensor,
    favour: Tensor | None = None,
    cells: CellStatistics | None = None,
) -> tuple[Tensor, Tensor]:
    """The largest value of `likelihood_surface`, `(*batch,)`, and its cell, `(*batch,)` int64.

    Args:
        dictionary: responses on the grid.
        whitener: of the background, batch `(*batch,)`.
        among: `(*batch,)` bool, the sequences to look at; others get minus infinity and cell 0.
        favour: `(*batch, C)` added to the surface, such as log-odds of the cells; None adds nothing.
        cells: of the same background, where they are known.
    """
    rows = among.flatten().nonzero().squeeze(-1)
    batch_dims = among.ndim

    def of_rows(tensor: Tensor) -> Tensor:
        return tensor.reshape(-1, *tensor.shape[batch_dims:])[rows]

    flat = tree_map(of_rows, whitener)
    if dictionary.response.ndim > 3 and len(rows) < among.numel():
        dictionary = dictionary._replace(response=dictionary.response[rows], energy=dictionary.energy[rows])
    added = flat.num_snapshots.new_zeros(len(rows), dictionary.points.shape[-2])
    if favour is not None:
        added = favour.reshape(among.numel(), -1)[rows]
    if not len(rows):
        return torch.full_like(among, -torch.inf, dtype=added.dtype), among.long()
    known = cell_statistics(dictionary, flat) if cells is None else tree_map(of_rows, cells)
    score, cell = _strongest(dictionary, flat, known, added)
    nowhere = score.new_full((among.numel(),), -torch.inf), rows.new_zeros(among.numel())
    score, cell = (
        t.index_copy(0, rows, f).reshape(among.shape) for t, f in zip(nowhere, (score, cell), strict=True)
    )
    return score, cell


def _strongest(
    dictionary: Dictionary, flat: Whitener, cells: CellStatistics, favour: Tensor
) -> tuple[Tensor, Tensor]:
    """The same for all of B sequences."""
    J, off = flat.num_snapshots, slack(flat.projection.shape[-2], favour.dtype)
    bound = _bounds(dictionary, cells, J, off) + favour
    promising = bound.topk(min(PROMISING, bound.shape[-1])).indices
    best = _exact(_take(dictionary.response, promising), flat)
    sure = best * (1 - off) - off * J.sum(-1)[:, None] + favour.gather(-1, promising)
    reached = sure.amax(-1)
    tested = (~(bound < reached[:, None])).scatter_(-1, promising, True)
    found = [_test(dictionary, flat, favour, b, row.nonzero().squeeze(-1)) for b, row in enumerate(tested)]
    score, cell = (torch.stack(t) for t in zip(*found, strict=True))
    return score, cell


def _bounds(dictionary: Dictionary, cells: CellStatistics, J: Tensor, off: float) -> Tensor:
    """Upper bounds of the surface, `(B, C)`, infinite where nothing bounds it."""
    tiny = 2 * torch.finfo(cells.s.dtype).tiny
    # With the error e, (sqrt(q) + e)^2 <= (1 + slack) q + (1 + 1 / slack) e^2.
    q = cells.q * (1 + off) ** 2 + cells.q_error[..., None] * dictionary.energy
    # Where rounding may hide all of s, the bound overflows to infinity less infinity, unless q is zero.
    lowest = (cells.s - cells.s_error[..., None] * dictionary.energy).clamp_min_(tiny)
    bound = peak_log_likelihood_ratio(J[..., None], lowest, q)[0].sum(-2)
    return bound.masked_fill_(bound.isnan(), torch.inf)


def _test(
    dictionary: Dictionary, whitener: Whitener, favour: Tensor, index: int, cells: Tensor
) -> tuple[Tensor, Tensor]:
    """Largest exact value of `(K,)` cells and its cell, of sequence `index`."""
    response = dictionary.response if dictionary.response.ndim == 3 else dictionary.response[index]
    score = _exact(response[:, cells], Whitener(*(t[index] for t in whitener))) + favour[index, cells]
    score, at = score.max(-1)
    return score, cells[at]


def _take(response: Tensor, cells: Tensor) -> Tensor:
    """`(B, I, K, M)` responses of cells `(B, K)`."""
    if response.ndim == 3:
        return response[:, cells].transpose(0, 1)
    return response.take_along_dim(cells[:, None, :, None], -2)


def _exact(response: Tensor, whitener: Whitener) -> Tensor:
    """Log-likelihood ratios `(*batch, K)` of responses `(*batch, I, K, M)`."""
    s, q = statistics(whitener, response)
    return peak_log_likelihood_ratio(whitener.num_snapshots[..., None], s, q)[0].sum(-2)
