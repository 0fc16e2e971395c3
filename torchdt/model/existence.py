"""Existence: survival, and the end of what leaves the region."""

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.model.region import Region


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
