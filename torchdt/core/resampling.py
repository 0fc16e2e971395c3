"""Systematic resampling and roughening."""

import math

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.core.weights import mean_and_covariance


def systematic_indices(log_weight: Tensor, offset: Tensor) -> Tensor:
    """Ancestors of a systematic resample (Kitagawa 1996), on cumulative sums.

    Args:
        log_weight: `(*batch, P)` normalised.
        offset: `(*batch,)` one uniform draw on [0, 1) each.

    Returns:
        `(*batch, P)` int64, non-decreasing; index p occurs `floor(P w_p)` or `ceil(P w_p)` times.
    """
    num = log_weight.shape[-1]
    points = (torch.arange(num, dtype=log_weight.dtype, device=log_weight.device) + offset[..., None]) / num
    return invert_cumulative(log_weight, points)


def invert_cumulative(log_weight: Tensor, points: Tensor) -> Tensor:
    """Indices at which the cumulative weights reach given levels; uniform levels draw from the weights.

    Args:
        log_weight: `(*batch, P)` normalised.
        points: `(*batch, S)` levels in [0, 1].

    Returns:
        `(*batch, S)` int64.
    """
    num = log_weight.shape[-1]
    cumulative = log_weight.detach().exp().cumsum(-1)
    # Rounding may leave the last sum beside one: rescale so that every point falls into an interval.
    cumulative = cumulative / cumulative[..., -1:]
    # A point may round to one, beyond every interval: it belongs to the last particle that has a weight.
    last = (cumulative < 1).sum(-1, keepdim=True).clamp_max(num - 1)
    return torch.minimum(torch.searchsorted(cumulative, points.contiguous(), right=True), last)


def stop_gradient_weights(log_weight: Tensor, ancestors: Tensor) -> Tensor:
    """Even log-weights after resampling that keep the gradient of the former weights.

    `log w' = -log P + log w[a] - sg(log w[a])`, sg stopping the gradient: `-log P` in value. A filter whose
    weights are cut off here instead has a biased score (Scibior and Wood 2021).

    Args:
        log_weight: `(*batch, P)` normalised.
        ancestors: `(*batch, P)` int64, of positive weight.

    Returns:
        `(*batch, P)`.
    """
    chosen = log_weight.gather(-1, ancestors)
    return chosen - chosen.detach() - math.log(ancestors.shape[-1])


def roughen(points: Tensor, log_weight: Tensor, draws: Tensor, bandwidth: float) -> Tensor:
    """Jitter particles by a Gaussian kernel that keeps their mean and covariance.

    `x' = m + sqrt(1 - h^2) (x - m) + h L e` with `L L^T` the covariance of the set (Liu and West 2001).

    Args:
        points: `(*batch, P, D)`.
        log_weight: `(*batch, P)` normalised.
        draws: `(*batch, P, D)` standard normal.
        bandwidth: h in [0, 1), in standard deviations of the set.
    """
    mean, covariance = mean_and_covariance(points, log_weight)
    kernel = bandwidth * (draws @ scale_tril(covariance).mT)
    mean = mean[..., None, :]
    return mean + (1 - bandwidth**2) ** 0.5 * (points - mean) + kernel


def scale_tril(covariance: Tensor) -> Tensor:
    """Lower factor of a covariance that may be singular (a set of few distinct points), `(*batch, D, D)`.

    The factorisation runs on correlations, so coordinates of unlike units do not upset it, with a
    relative jitter of a few rounding units on the diagonal.
    """
    variance = covariance.diagonal(dim1=-2, dim2=-1)
    tiny = torch.finfo(covariance.dtype).tiny
    deviation = variance.clamp_min(tiny).sqrt()
    correlation = covariance / (deviation[..., :, None] * deviation[..., None, :])
    jitter = 100 * torch.finfo(covariance.dtype).eps
    eye = torch.eye(covariance.shape[-1], dtype=covariance.dtype, device=covariance.device)
    lower = cholesky((1 - jitter) * correlation + 2 * jitter * eye, "covariance of a particle set")
    return deviation[..., :, None] * lower
