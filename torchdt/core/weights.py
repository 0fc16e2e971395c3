"""Log-weights of particle sets."""

import torch
from torch import Tensor


def normalise(log_weight: Tensor) -> tuple[Tensor, Tensor]:
    """Normalise log-weights over the last dimension.

    Args:
        log_weight: `(*batch, P)`; minus infinity is a zero weight.

    Returns:
        Normalised log-weights `(*batch, P)` and the log of their former sum `(*batch,)`. Where every
        weight is zero the sum is minus infinity and the weights become uniform.
    """
    top = log_weight.amax(-1, keepdim=True)
    none = top.isneginf()
    # Log-likelihoods of 1e5 and more have rounding errors of percents: take the largest off before the
    # sum, or the weights would not add up to one.
    shifted = torch.where(none, 0.0, log_weight - torch.where(none, 0.0, top))
    log_sum = shifted.exp().sum(-1, keepdim=True).log()
    total = torch.where(none, -torch.inf, top + log_sum)
    return shifted - log_sum, total.squeeze(-1)


def log_sum(log_weight: Tensor, dim: int) -> Tensor:
    """`logsumexp` over one dimension, whose derivative is nothing, not nan, where every weight is zero."""
    none = log_weight.isneginf().all(dim, keepdim=True)
    total = torch.logsumexp(torch.where(none, 0.0, log_weight), dim)
    return torch.where(none.squeeze(dim), -torch.inf, total)


def effective_sample_size(log_weight: Tensor) -> Tensor:
    """`1 / sum w^2` of normalised log-weights, `(*batch, P)` to `(*batch,)`."""
    return torch.exp(-torch.logsumexp(2 * log_weight, -1))


def mean_and_covariance(points: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted mean `(*batch, D)` and covariance `(*batch, D, D)` of points `(*batch, P, D)`."""
    mean, centred, weight = _centred(points, log_weight)
    return mean.to(points.dtype), ((weight * centred).mT @ centred).to(points.dtype)


def standard_deviation(points: Tensor, log_weight: Tensor) -> Tensor:
    """Weighted standard deviation `(*batch, D)` of each entry of points `(*batch, P, D)`."""
    _, centred, weight = _centred(points, log_weight)
    return (weight * centred.square()).sum(-2).sqrt().to(points.dtype)


def _centred(points: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weighted mean, points less that mean, and weights `(*batch, P, 1)`, in double precision."""
    # A sum of a thousand nearly equal squares loses four digits in single precision, enough to make the
    # covariance of a set of few distinct points indefinite.
    exact, weight = points.double(), log_weight.double().exp()[..., None]
    mean = (weight * exact).sum(-2)
    return mean, exact - mean[..., None, :], weight


def weighted_mean(values: Tensor, log_weight: Tensor) -> Tensor:
    """Mean over the last dimension under normalised log-weights."""
    return (log_weight.exp() * values).sum(-1)
