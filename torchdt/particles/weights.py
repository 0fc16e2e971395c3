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
    total = torch.logsumexp(log_weight, -1)
    none = total.isneginf()[..., None]
    uniform = torch.zeros_like(log_weight) - torch.log(torch.tensor(float(log_weight.shape[-1])))
    return torch.where(none, uniform, log_weight - torch.where(none, 0.0, total[..., None])), total


def effective_sample_size(log_weight: Tensor) -> Tensor:
    """`1 / sum w^2` of normalised log-weights, `(*batch, P)` to `(*batch,)`."""
    return torch.exp(-torch.logsumexp(2 * log_weight, -1))


def mean_and_covariance(points: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted mean `(*batch, D)` and covariance `(*batch, D, D)` of points `(*batch, P, D)`."""
    weight = log_weight.exp()[..., None]
    mean = (weight * points).sum(-2)
    centred = points - mean[..., None, :]
    return mean, (weight * centred).mT @ centred
