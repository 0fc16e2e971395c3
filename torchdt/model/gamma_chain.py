"""Gamma Markov chains for transmit powers and noise variances.

The transition `f(v' | v) = G(v'; v / c, c)` (scale v / c, shape c) keeps the mean and adds a relative
standard deviation of `1 / sqrt(c)`. In logarithms it is a random walk, `log v' = log v + log g` with
`g ~ G(1 / c, c)`, so the mean and variance of `log v` propagate exactly. A belief is a weighted set of
support points; prediction places new ones at the Gauss-Hermite nodes of the propagated moments.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchdt.state import weighted_mean


def predict_chain(values: Tensor, log_weight: Tensor, shape: Tensor | float) -> tuple[Tensor, Tensor]:
    """One Gamma transition of a belief given by support points.

    Args:
        values: `(*batch, G)` positive support points.
        log_weight: `(*batch, G)` normalised log-weights.
        shape: c, positive.

    Returns:
        Support points and log-weights of the predicted belief, `(*batch, G)` each.
    """
    c = torch.as_tensor(shape, dtype=values.dtype, device=values.device)
    log_values = values.log()
    mean = weighted_mean(log_values, log_weight)
    variance = weighted_mean((log_values - mean[..., None]).square(), log_weight)
    mean = mean + torch.special.digamma(c) - c.log()
    variance = variance + torch.special.polygamma(1, c)
    node, node_log_weight = (values.new_tensor(a) for a in _gauss_hermite(values.shape[-1]))
    predicted = torch.exp(mean[..., None] + variance.sqrt()[..., None] * node)
    return predicted, node_log_weight.expand_as(predicted)


def uniform_prior(maximum: Tensor, num_points: int, decades: float = 7.0) -> tuple[Tensor, Tensor]:
    """Support points of the uniform density on [0, maximum], spaced evenly in the logarithm.

    Args:
        maximum: `(*batch,)` positive.
        num_points: G.
        decades: points reach down to `maximum * 10**-decades`; the density below is left out.

    Returns:
        Support points and normalised log-weights (each point stands for its logarithmic bin).
    """
    width = decades * math.log(10.0) / num_points
    log_value = -width * (torch.arange(num_points, dtype=maximum.dtype, device=maximum.device) + 0.5).flip(0)
    points = maximum[..., None] * log_value.exp()
    return points, torch.log_softmax(log_value, -1).expand_as(points)


def uniform_prior_around(
    scale: Tensor, maximum: Tensor, num_points: int, reach: tuple[float, float] = (3.0, 4.0)
) -> tuple[Tensor, Tensor]:
    """Support points of the uniform density on [0, maximum], dense where a likelihood is known to lie.

    Points are spaced evenly in the logarithm. What is below them counts with the lowest one; what is above
    is left out, so the weights may add up to less than one.

    Args:
        scale: `(*batch,)` positive, where the likelihood lies.
        maximum: `(*batch,)` positive.
        num_points: G.
        reach: how far the points go below and above the scale, natural logarithm.

    Returns:
        Support points and log-weights `(*batch, G)`; each point stands for its logarithmic bin.
    """
    log_scale = torch.minimum(scale, maximum).log()[..., None]
    log_top = torch.minimum(log_scale + reach[1], maximum.log()[..., None])
    along = torch.linspace(0, 1, num_points + 1, dtype=maximum.dtype, device=maximum.device)
    log_edge = torch.lerp(log_scale - reach[0], log_top, along)
    points = (0.5 * (log_edge[..., 1:] + log_edge[..., :-1])).exp()
    edge = torch.cat([torch.zeros_like(log_top), log_edge[..., 1:].exp()], -1)
    return points, (edge.diff(dim=-1) / maximum[..., None]).log()


@lru_cache
def _gauss_hermite(num_points: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Arrays, not tensors: those made in inference mode could not be used for a gradient later.
    node, weight = np.polynomial.hermite_e.hermegauss(num_points)
    return node, np.log(weight) - 0.5 * math.log(2 * math.pi)
