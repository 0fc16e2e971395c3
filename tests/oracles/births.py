"""Exact evidence of one step of Poisson births: sums over bearings and powers, known noise (float64).

`f = e^-mu [f_0 + mu int f_1(x) dx / |R| + mu^2 / 2 int int f_2(x, y) dx dy / |R|^2]`, everything over f_0.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor


def likelihood_ratio(columns: Tensor, factor: Tensor, num_snapshots: int, noise: float) -> Tensor:
    """`log CN(z; 0, A A^H + eta I) - log CN(z; 0, eta I)` by the determinant lemma, `(*batch,)`.

    Args:
        columns: A, `(*batch, M, n)`.
        factor: B of the scatter matrix, `(M, R)`.
        num_snapshots: J.
        noise: eta.
    """
    gram = torch.eye(columns.shape[-1], dtype=columns.dtype) + columns.mH @ columns / noise
    lower = torch.linalg.cholesky(gram)
    log_det = 2 * lower.diagonal(dim1=-2, dim2=-1).real.log().sum(-1)
    solved = torch.linalg.solve_triangular(lower, columns.mH @ factor, upper=False)
    return -num_snapshots * log_det + solved.abs().square().sum((-2, -1)) / noise**2


def uniform_powers(limit: float, num: int) -> tuple[Tensor, Tensor]:
    """Points and log-weights of the uniform density on [0, limit]: the trapezoid rule in log-power."""
    log_share = torch.linspace(-4 * math.log(10), 0, num, dtype=torch.float64)
    log_weight = log_share + (log_share[1] - log_share[0]).log()
    log_weight[-1] -= math.log(2)
    log_weight[0] = log_share[0]  # and all below
    return limit * log_share.exp(), log_weight


def one_object(respond: Callable, x: Tensor, factor: Tensor, num_snapshots: int, noise: float, limit: float):
    """Log of f_1 over f_0 at bearings `(X,)`, powers averaged over; `factor` is `(I, M, R)`."""
    power, log_weight = uniform_powers(limit, 400)
    total = 0
    for tone, response in zip(factor, respond(x[:, None]).unbind(-2), strict=True):
        columns = response[:, None, :, None] * power.sqrt()[:, None, None]
        total = total + (likelihood_ratio(columns, tone, num_snapshots, noise) + log_weight).logsumexp(-1)
    return total


def two_objects(
    respond: Callable, x: Tensor, y: Tensor, factor: Tensor, num_snapshots: int, noise: float, limit: float
):
    """Log of f_2 over f_0 at pairs of bearings `(X,)` and `(Y,)`, `(X, Y)`."""
    power, log_weight = uniform_powers(limit, 26)
    root = torch.cartesian_prod(power, power).sqrt()
    log_weight = (log_weight[:, None] + log_weight).flatten()
    total = 0
    for tone, first, second in zip(
        factor, respond(x[:, None]).unbind(-2), respond(y[:, None]).unbind(-2), strict=True
    ):
        rows = []
        for a in first:
            pair = torch.stack([a.expand_as(second), second], -1)  # (Y, M, 2)
            ratio = likelihood_ratio(pair[:, None] * root[:, None, :], tone, num_snapshots, noise)
            rows.append((ratio + log_weight).logsumexp(-1))
        total = total + torch.stack(rows)
    return total
