"""The quadratic forms of all cells, from few eigenvectors of what they are tested against.

Most of what a cell costs is `s = a^H Sigma^-1 a`. Where the background is noise and a few objects, few
eigenvalues mu of `Sigma^-1` lie much below its bulk, and with their eigenvectors u

    `s = mu_bulk |a|^2 - sum_k (mu_bulk - mu_k) |u_k^H a|^2`

but for the differences within the bulk.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.filter.bp.rank_one import Whitener, squared_products
from torchdt.filter.proposal.dictionary import Dictionary

BULK = 1.01
"""Eigenvalues of the inverse background less than this factor below the largest need no eigenvector."""

BLOCK = 1_000_000
"""Numbers of the largest tensor, to stay within the cache of a processor."""


class CellStatistics(NamedTuple):
    """Quadratic forms s and q of every cell, see `torchdt.filter.bp.rank_one`.

    Attributes:
        s, q: `(*batch, I, C)`.
        s_error: `(*batch, I)`, s is off by at most this times `|a|^2`.
        q_error: `(*batch, I)`, and q by this times `|a|^2`, beside a factor of `(1 + slack)^2`.
    """

    s: Tensor
    q: Tensor
    s_error: Tensor
    q_error: Tensor


class Unexplained(NamedTuple):
    """What known objects and the noise leave unexplained.

    Attributes:
        cells: statistics of every cell.
        noise: `(*batch, I)` mean noise variance that these were computed with.
        received: `(*batch, I)` power of the known objects, sum over the sensors.
    """

    cells: CellStatistics
    noise: Tensor
    received: Tensor


def received_power(signal: Tensor) -> Tensor:
    """Power of a signal of covariance `(*batch, I, M, M)`, sum over the sensors, `(*batch, I)`."""
    return signal.diagonal(dim1=-2, dim2=-1).real.sum(-1)


def slack(num_sensors: int, dtype: torch.dtype) -> float:
    """How far rounding may move `|W^H a|`, relative to its largest value for that `|a|`, with room to spare.

    An inner product of M complex numbers is wrong by up to sqrt(2) M eps times their norms (Higham, Accuracy
    and Stability of Numerical Algorithms, 2nd ed. 2002, ch. 3), and M of them by sqrt(M) times as much. This
    is absolute: where the sum cancels, next to strong objects, nothing holds relative to what is left.
    """
    return 4 * num_sensors**1.5 * torch.finfo(dtype).eps


def cell_statistics(dictionary: Dictionary, whitener: Whitener) -> CellStatistics:
    """The quadratic forms of every cell; a constant to any gradient.

    Args:
        dictionary: responses on the grid.
        whitener: of the background, batch `(B,)` or none.
    """
    with torch.no_grad():
        num_sensors = whitener.projection.shape[-2]
        root, spread = whitener.projection.tensor_split([num_sensors], -1)
        level, vector = torch.linalg.eigh(root @ root.mH)
        in_bulk = level * BULK >= level[..., -1:]
        bulk = (level * in_bulk).sum(-1) / in_bulk.sum(-1)
        lowest = torch.where(in_bulk, level, torch.inf).amin(-1)
        # How many eigenvectors a sequence takes must not depend on the others.
        few = int((~in_bulk).sum(-1).max())
        below = torch.where(in_bulk, 0.0, bulk[..., None] - level).clamp_min(0)[..., :few]
        columns = torch.cat([vector[..., :few] * below.sqrt()[..., None, :], spread], -1)
        taken, q = _products(dictionary, columns, few)
        off = slack(num_sensors, level.dtype)
        # With the error e, (sqrt(q) + e)^2 <= (1 + slack) q + (1 + 1 / slack) e^2.
        q_error = (1 + off) ** 2 * off / num_sensors * spread.abs().square().sum((-2, -1))
        s_error = bulk - lowest + 2 * off * level[..., -1]
        return CellStatistics(bulk[..., None] * dictionary.energy - taken, q, s_error, q_error)


def _products(dictionary: Dictionary, columns: Tensor, few: int) -> tuple[Tensor, Tensor]:
    """Sums of `|w^H a|^2` over the first few columns w and over the others, `(*batch, I, C)` each."""
    *batch, num_tones, num_sensors, width = columns.shape
    flat = columns.reshape(-1, num_tones, num_sensors, width)
    block = max(1, BLOCK // (2 * len(flat) * num_tones * width))
    parts = []
    for response in dictionary.response.split(block, -2):
        if response.ndim == 3:  # one dictionary for all sequences, which is then read only once
            squares = squared_products(flat.permute(1, 2, 0, 3).flatten(-2), response)
            squares = squares.unflatten(-2, (len(flat), 2 * width)).transpose(0, 1)
        else:
            squares = squared_products(flat, response)
        parts.append([t.sum(-2) for t in squares.split([2 * few, 2 * (width - few)], -2)])
    taken, q = (torch.cat(t, -1).reshape(*batch, num_tones, -1) for t in zip(*parts, strict=True))
    return taken, q
