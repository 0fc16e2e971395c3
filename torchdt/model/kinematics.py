"""Constant-rate motion and survival."""

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.model.region import Region


def predict_state(state: Tensor, driving: Tensor, step_s: float, driving_variance: Tensor) -> Tensor:
    """Move particles by the constant-rate model `x' = F x + W q`.

    Per coordinate `F = [[1, T], [0, 1]]`, `W = [T^2 / 2, T]^T` and `q ~ N(0, driving_variance)`
    (Bar-Shalom, Kirubarajan and Li, Estimation with Applications to Tracking and Navigation, Ch. 6.3).

    Args:
        state: `(*batch, 2 d)` positions, then rates.
        driving: `(*batch, d)` standard normal draws.
        step_s: time step T in seconds.
        driving_variance: `(d,)` variance of q.

    Returns:
        `(*batch, 2 d)`.
    """
    position, rate = state.chunk(2, dim=-1)
    q = driving * driving_variance.sqrt()
    return torch.cat([position + step_s * rate + 0.5 * step_s**2 * q, rate + step_s * q], dim=-1)


def predict_log_odds(log_odds: Tensor, survival: Tensor | float) -> Tensor:
    """Existence after one step: `r' = p_s r`, in log-odds.

    Args:
        log_odds: `(*batch, N)`.
        survival: p_s, a probability.
    """
    survival = torch.as_tensor(survival, dtype=log_odds.dtype, device=log_odds.device)
    log_r = logsigmoid(log_odds) + survival.log()
    return log_r - torch.log1p(-log_r.exp())


def drop_outside(state: Tensor, log_weight: Tensor, region: Region) -> Tensor:
    """Take the weight from particles that left the region.

    The weights are not renormalised: what is lost is the probability that the object left.

    Args:
        state: `(*batch, P, D)`.
        log_weight: `(*batch, P)`.
    """
    return torch.where(region.contains(state), log_weight, -torch.inf)
