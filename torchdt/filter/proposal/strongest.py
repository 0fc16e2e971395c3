"""The cell where one more object raises the likelihood most, found without testing every cell exactly.

Most of what a cell costs is `s = a^H Sigma^-1 a`. Where the background is noise and a few strong objects, few
eigenvalues mu of `Sigma^-1` lie much below its bulk, and with their eigenvectors u

    `s >= mu_bulk |a|^2 - sum_k (mu_bulk - mu_k) |u_k^H a|^2`

bounds the log-likelihood ratio of every cell from above, tightly. Only cells whose bound reaches the largest
value of the most promising ones are tested: the result is that of testing all. So that this holds in floating
point too, the bounds make room for all rounding, theirs and that of the test, see `_slack`.
"""

import torch
from torch import Tensor

from torchdt.filter.bp.rank_one import Whitener, peak_log_likelihood_ratio, squared_products, statistics
from torchdt.filter.proposal.dictionary import Dictionary, likelihood_surface

BULK = 1.05
"""Eigenvalues of the inverse background less than this factor below the largest need no eigenvector."""

PROMISING = 32
"""Cells tested first, those of the largest bounds: next to strong objects a few bounds are loose."""

BLOCK = 1_000_000
"""Numbers of the largest tensor, to stay within the cache of a processor."""


def strongest_cell(
    dictionary: Dictionary, whitener: Whitener, among: Tensor, favour: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """The largest value of `likelihood_surface`, `(*batch,)`, and its cell, `(*batch,)` int64.

    Args:
        dictionary: responses on the grid.
        whitener: of the background, batch `(*batch,)`.
        among: `(*batch,)` bool, the sequences to look at; others get minus infinity and cell 0.
        favour: `(*batch, C)` added to the surface, such as log-odds of the cells; None adds nothing.
    """
    rows = among.flatten().nonzero().squeeze(-1)
    flat = Whitener(*(t.reshape(-1, *t.shape[among.ndim :])[rows] for t in whitener))
    if dictionary.response.ndim > 3 and len(rows) < among.numel():
        dictionary = dictionary._replace(response=dictionary.response[rows], energy=dictionary.energy[rows])
    added = flat.num_snapshots.new_zeros(len(rows), dictionary.points.shape[-2])
    if favour is not None:
        added = favour.reshape(among.numel(), -1)[rows]
    best = _strongest(dictionary, flat, added) if len(rows) else (flat.num_snapshots.sum(-1), rows)
    nowhere = (best[0].new_full((among.numel(),), -torch.inf), rows.new_zeros(among.numel()))
    score, cell = (t.index_copy(0, rows, b).reshape(among.shape) for t, b in zip(nowhere, best, strict=True))
    return score, cell


def _strongest(dictionary: Dictionary, flat: Whitener, favour: Tensor) -> tuple[Tensor, Tensor]:
    """The same for all of B sequences."""
    num_sensors = flat.projection.shape[-2]
    root, spread = flat.projection.tensor_split([num_sensors], -1)
    level, vector = torch.linalg.eigh(root @ root.mH)
    few = int((level * BULK < level[..., -1:]).sum(-1).max())
    if few > num_sensors // 2:
        score, cell = (likelihood_surface(dictionary, flat) + favour).max(-1)
        return score, cell
    bulk, J = level[..., few], flat.num_snapshots
    strong = vector[..., :few] * (bulk[..., None] - level[..., :few]).clamp_min(0).sqrt()[..., None, :]
    slack = _slack(num_sensors, level.dtype)
    columns = torch.cat([strong, spread * (1 + slack)], -1)
    bound = _bounds(dictionary, columns, few, J, bulk - 2 * slack * level[..., -1]) + favour
    promising = bound.topk(min(PROMISING, bound.shape[-1])).indices
    best = _exact(_take(dictionary.response, promising), flat)
    sure = best * (1 - slack) - slack * J.sum(-1)[:, None] + favour.gather(-1, promising)
    reached = sure.amax(-1)
    tested = (~(bound < reached[:, None])).scatter_(-1, promising, True)
    each = [_test(dictionary, flat, favour, b, row.nonzero().squeeze(-1)) for b, row in enumerate(tested)]
    score, cell = (torch.stack(t) for t in zip(*each, strict=True))
    return score, cell


def _slack(num_sensors: int, dtype: torch.dtype) -> float:
    """How far rounding may move `|W^H a|`, relative to its largest value for that `|a|`, with room to spare.

    An inner product of M complex numbers is wrong by up to sqrt(2) M eps |w| |a| (Higham, Accuracy and
    Stability of Numerical Algorithms, 2nd ed. 2002, ch. 3), and M of them by sqrt(M) times as much. This is
    absolute: where the sum cancels, next to strong objects, nothing holds relative to what is left.
    """
    return 4 * num_sensors**1.5 * torch.finfo(dtype).eps


def _bounds(dictionary: Dictionary, columns: Tensor, few: int, J: Tensor, bulk: Tensor) -> Tensor:
    """Upper bounds of the surface, `(B, C)`, infinite where nothing bounds it.

    Args:
        columns: `(B, I, M, few + R)` complex, what the responses are multiplied by.
        few: number of those of s.
        J, bulk: `(B, I)` number of snapshots; that of which they are taken off.
    """
    num, num_tones, num_sensors, width = columns.shape
    # With the error e, (sqrt(q) + e)^2 <= (1 + slack) q + (1 + 1 / slack) e^2; the columns hold 1 + slack.
    error = _slack(num_sensors, bulk.dtype) / num_sensors * columns[..., few:].abs().square().sum((-2, -1))
    tiny = 2 * torch.finfo(bulk.dtype).tiny
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
        q.addcmul_(error[..., None], energy.expand_as(q))
        # Where rounding may hide all of s, the bound overflows to infinity less infinity, unless q is zero.
        lowest = (bulk[..., None] * energy - s).clamp_min_(tiny)
        bounds.append(peak_log_likelihood_ratio(J[..., None], lowest, q)[0].sum(-2))
    bound = torch.cat(bounds, -1)
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
