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


def predict_log_odds(log_odds: Tensor, survival: Tensor | float, log_mass_inside: Tensor) -> Tensor:
    """Existence after one step: `r' = p_s r m`, with m the predicted mass inside the region.

    Args:
        log_odds: `(*batch, N)`.
        survival: p_s, a probability.
        log_mass_inside: `(*batch, N)` log m, at most 0.
    """
    survival = torch.as_tensor(survival, dtype=log_odds.dtype, device=log_odds.device)
    log_r = logsigmoid(log_odds) + survival.log() + log_mass_inside.clamp_max(0.0)
    return log_r - torch.log1p(-log_r.exp())


def drop_outside(state: Tensor, log_weight: Tensor, region: Region) -> tuple[Tensor, Tensor]:
    """Take the weight from particles that left the region.

    Args:
        state: `(*batch, P, D)`.
        log_weight: `(*batch, P)` normalised.

    Returns:
        Renormalised log-weights `(*batch, P)` and the log of the mass that stayed inside, `(*batch,)`.
        Where nothing stayed the mass is minus infinity and the weights are left as they were.
    """
    kept = torch.where(region.contains(state), log_weight, -torch.inf)
    log_mass = torch.logsumexp(kept, -1)
    gone = log_mass.isneginf()[..., None]
    return torch.where(gone, log_weight, kept - log_mass[..., None]), log_mass
