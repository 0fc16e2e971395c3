"""Exact filter of one object that may fall silent: sums over a fine grid, existence transmission (float64).

The object moves by a random walk; noise and power are known, so that nothing is approximated but the grid.
"""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import torch
from oracles.births import likelihood_ratio
from torch import Tensor


class Exact(NamedTuple):
    """After each of K steps.

    Attributes:
        existence, transmission: `(K,)`, the latter given existence: of one tone at least.
        mean, deviation: `(K,)` of the bearing given existence.
        log_evidence: `(K,)` over that of noise alone.
    """

    existence: Tensor
    transmission: Tensor
    mean: Tensor
    deviation: Tensor
    log_evidence: Tensor


def switching_filter(
    respond: Callable,
    snapshots: Tensor,
    x: Tensor,
    start: Tensor,
    existence: float,
    *,
    power: float,
    noise: float,
    walk: float,
    survival: Tensor,
    falls_silent: Tensor,
    resumes: Tensor,
    together: bool = True,
) -> Exact:
    """Run the filter over snapshots `(K, I, J, M)`, from a prior on bearings `(X,)` of one that transmits.

    Args:
        respond: maps `(X, 1)` to `(X, I, M)`.
        walk: standard deviation of the random walk in a step.
        together: whether all tones are switched together, or each on its own.
    """
    kernel = torch.exp(-0.5 * ((x[:, None] - x) / walk).square())
    kernel = kernel / kernel.sum(0)
    one = torch.stack([torch.stack([1 - resumes, falls_silent]), torch.stack([resumes, 1 - falls_silent])])
    switch, tones = one, snapshots.shape[1]
    for _ in range(0 if together else tones - 1):
        switch = torch.kron(switch, one)
    # Which tones are sent: all or none, or all combinations, the one of all of them last.
    sent = list(itertools.product((False, True), repeat=1 if together else tones))
    alive = torch.stack([torch.zeros_like(start)] * (len(sent) - 1) + [start]) * existence
    dead, rows = torch.tensor(1 - existence, dtype=x.dtype), []
    for z in snapshots:
        dead = dead + (1 - survival) * alive.sum()
        alive = survival * switch @ (alive @ kernel.T)
        ratios = []
        for tone, response in zip(z, respond(x[:, None]).unbind(-2), strict=True):
            columns = (power**0.5 * response)[..., None]
            ratios.append(likelihood_ratio(columns, tone.mT, len(tone), noise))
        ratio = torch.stack([sum(ratios)] if together else ratios)
        alive = alive * (torch.tensor(sent).to(ratio) @ ratio).exp()
        total = dead + alive.sum()
        dead, alive = dead / total, alive / total
        r, belief = alive.sum(), alive.sum(0) / alive.sum()
        mean = (belief * x).sum()
        deviation = (belief * (x - mean).square()).sum().sqrt()
        rows.append(torch.stack([r, 1 - alive[0].sum() / r, mean, deviation, total.log()]))
    return Exact(*torch.stack(rows, -1))
