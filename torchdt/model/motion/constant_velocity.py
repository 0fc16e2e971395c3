"""Constant-rate motion and survival."""

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.model.region import Region


def predict_state(state: Tensor, driving: Tensor, step_s: float) -> Tensor:
    """Move particles by the constant-rate model `x' = F x + W q`.

    Per coordinate `F = [[1, T], [0, 1]]`, `W = [T^2 / 2, T]^T` and `q ~ N(0, driving_variance)`
    (Bar-Shalom, Kirubarajan and Li, Estimation with Applications to Tracking and Navigation, Ch. 6.3).

    Args:
        state: `(*batch, 2 d)` positions, then rates.
        driving: `(*batch, d)` driving noise q, unit / s^2.
        step_s: time step T in seconds.

    Returns:
        `(*batch, 2 d)`.
    """
    position, rate = state.chunk(2, dim=-1)
    return torch.cat([position + step_s * rate + 0.5 * step_s**2 * driving, rate + step_s * driving], dim=-1)


def predict_moments(
    mean: Tensor, covariance: Tensor, step_s: float, driving_variance: Tensor
) -> tuple[Tensor, Tensor]:
    """Mean and covariance after one step of the constant-rate model: `F m` and `F C F^T + W Q W^T`.

    Args:
        mean: `(*batch, 2 d)`.
        covariance: `(*batch, 2 d, 2 d)`.
        step_s: time step T in seconds.
        driving_variance: `(*batch, d)` diagonal of Q, (unit / s^2)^2.
    """
    d = mean.shape[-1] // 2
    eye = torch.eye(d, dtype=mean.dtype, device=mean.device)
    F = torch.cat([torch.cat([eye, step_s * eye], 1), torch.cat([torch.zeros_like(eye), eye], 1)], 0)
    W = torch.cat([0.5 * step_s**2 * eye, step_s * eye], 0)
    return mean @ F.mT, F @ covariance @ F.mT + (W * driving_variance[..., None, :]) @ W.mT


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
    """Take the weight from particles outside the region.

    The weights are not renormalised: what is lost is the probability of being outside.

    Args:
        state: `(*batch, P, D)`.
        log_weight: `(*batch, P)`.
    """
    return torch.where(region.contains(state), log_weight, -torch.inf)


def condition_inside(state: Tensor, log_weight: Tensor, region: Region) -> tuple[Tensor, Tensor]:
    """Weights given that the object is in the region, and the logarithm of the probability that it is.

    An object that leaves the region ends: `r' = p_s P(inside) r`, see `predict_log_odds`.

    Args:
        state: `(*batch, P, D)`.
        log_weight: `(*batch, P)` normalised.

    Returns:
        Log-weights `(*batch, P)`, and log P(inside) `(*batch,)`: zero where no particle is outside, and never
        below the smallest number of the type.
    """
    inside = region.contains(state)
    kept = torch.where(inside, log_weight, -torch.inf)
    smallest = torch.finfo(log_weight.dtype).tiny
    # Not the sum of the weights where all are inside: their rounding, and its gradient, are no death.
    log_inside = torch.where(inside.all(-1), 0.0, kept.exp().sum(-1).clamp_min(smallest).log())
    return kept - log_inside[..., None], log_inside
