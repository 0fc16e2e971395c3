"""Gamma Markov chains for transmit powers and noise variances.

The transition `f(v' | v) = G(v'; v / c, c)` (scale v / c, shape c) keeps the mean and adds a relative
standard deviation of `1 / sqrt(c)` (Liang and Meyer, Sec. IV). In logarithms it is a random walk,
`log v' = log v + log g` with `g ~ G(1 / c, c)`. A belief is a weighted set of support points.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.distributions import constraints

from torchdt.core.ranges import Range
from torchdt.core.support import Support
from torchdt.core.weights import weighted_mean

LEAST_SHAPE = 1.0
"""Smallest shape c of a chain: a relative standard deviation of one per step. Below, the density of the next
value has a pole at zero, and few support points cannot stand for it."""

SHAPE = Support(
    Range(f"a finite number of at least {LEAST_SHAPE:g}", low=LEAST_SHAPE),
    constraints.greater_than(LEAST_SHAPE),
)

WIDEST = 4.0
"""Largest standard deviation of the logarithm of a predicted belief: a factor of 50. Wider ones say
nothing more, and their support points leave the range of single precision."""


def predict_chain(values: Tensor, log_weight: Tensor, shape: Tensor | float) -> tuple[Tensor, Tensor]:
    """One Gamma transition of a belief given by support points.

    The predicted belief stands on the Gauss-Hermite nodes of a log-normal density. Its mean is that of the
    belief, and its logarithm has the variance of `log v` plus `polygamma(1, c)`, that of `log g`: both exact,
    the variance up to `WIDEST` squared.

    Args:
        values: `(*batch, G)` positive support points.
        log_weight: `(*batch, G)` normalised log-weights.
        shape: c, at least `LEAST_SHAPE`.

    Returns:
        Support points and log-weights of the predicted belief, `(*batch, G)` each.
    """
    c = torch.as_tensor(shape, dtype=values.dtype, device=values.device)
    log_values = values.log()
    centre = weighted_mean(log_values, log_weight)
    variance = weighted_mean((log_values - centre[..., None]).square(), log_weight)
    spread = (variance + torch.special.polygamma(1, c)).sqrt().clamp_max(WIDEST)
    node, node_log_weight = (values.new_tensor(a) for a in _gauss_hermite(values.shape[-1]))
    along = spread[..., None] * node
    # The sum over the nodes, not its limit exp(spread^2 / 2): the mean is then exact for any number of them.
    scale = weighted_mean(values, log_weight).log() - torch.logsumexp(along + node_log_weight, -1)
    predicted = torch.exp(scale[..., None] + along)
    return predicted, node_log_weight.expand_as(predicted)


def uniform_prior(maximum: Tensor, num_points: int, decades: float = 7.0) -> tuple[Tensor, Tensor]:
    """Support points of the uniform density on [0, maximum], spaced evenly in the logarithm.

    Args:
        maximum: `(*batch,)` positive.
        num_points: G.
        decades: points reach down to `maximum * 10**-decades`; the density below it, 1e-7 in all,
            is left out.

    Returns:
        Support points and normalised log-weights (each point stands for its logarithmic bin).
    """
    width = decades * math.log(10.0) / num_points
    log_value = -width * (torch.arange(num_points, dtype=maximum.dtype, device=maximum.device) + 0.5).flip(0)
    points = maximum[..., None] * log_value.exp()
    return points, torch.log_softmax(log_value, -1).expand_as(points)


def predicted_uniform_prior(
    maximum: Tensor, num_points: int, shape: Tensor | float, decades: float = 7.0
) -> tuple[Tensor, Tensor]:
    """Support points of the uniform density on [0, maximum] after one Gamma transition.

    What becomes of a uniform density is a mixture of uniform ones, on [0, g maximum] with `g ~ G(1 / c, c)`;
    the probability of a bin under each is known exactly. In contrast to `predict_chain`, values far below the
    maximum keep their probability.

    Args:
        maximum: `(*batch,)` positive, before the transition.
        num_points: E.
        shape: c, at least `LEAST_SHAPE`.
        decades: points reach down by so many; the density below is left out. Seven hold noise 70 dB below
            the energy of a sensor.

    Returns:
        Support points, each the mean of a bin, and normalised log-weights, `(*batch, E)`. Bins are evenly
        spaced in the logarithm.
    """
    c = torch.as_tensor(shape, dtype=maximum.dtype, device=maximum.device).expand_as(maximum)[..., None]
    along = torch.linspace(-8.0, 6.0, 64, dtype=maximum.dtype, device=maximum.device)
    centre, spread = torch.digamma(c) - c.log(), torch.special.polygamma(1, c).sqrt()
    log_gain = centre + spread * along
    # In units of the maximum. Less one, so that large shapes do not lose the difference to rounding.
    log_gain_weight = torch.log_softmax(c * (log_gain - log_gain.expm1()), -1)
    gain, gain_weight = log_gain.exp()[..., None], log_gain_weight.exp()[..., None]
    width = decades * math.log(10.0) / num_points
    bins = torch.arange(-num_points, 1, dtype=maximum.dtype, device=maximum.device)
    edge = torch.minimum((centre + 3 * spread + width * bins).exp()[..., None, :], gain)
    weight = (gain_weight * edge.diff(dim=-1) / gain).sum(-2)
    moment = (gain_weight * edge.square().diff(dim=-1) / gain).sum(-2) / 2
    return maximum[..., None] * moment / weight, torch.log(weight / weight.sum(-1, keepdim=True))


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
        reach: how far the points go below and above the scale, natural logarithm: 13 and 17 dB. With one
            snapshot a power is known to a factor of e, and errs on the low side more often.

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


def log_walk(level: Tensor, shape: Tensor) -> Tensor:
    """One Gamma transition between few levels, `(*batch, L, L)`: the logarithm takes steps to its neighbours.

    Its variance is that of `log g`, `polygamma(1, c)`, as far as neighbours go; at the ends it stays.

    Args:
        level: `(L,)` evenly spaced in the logarithm.
        shape: c, `(*batch,)`.
    """
    if len(level) == 1:
        return torch.ones_like(shape)[..., None, None]
    width = (level[-1] / level[0]).log() / (len(level) - 1)
    away = (torch.special.polygamma(1, shape) / width.square() / 2).clamp_max(0.5)[..., None]
    beside = torch.diag_embed(away.expand(*away.shape[:-1], len(level) - 1), 1)
    beside = beside + beside.mT
    return beside + torch.diag_embed(1 - beside.sum(-1))


@lru_cache
def _gauss_hermite(num_points: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Arrays, not tensors: those made in inference mode could not be used for a gradient later.
    node, weight = np.polynomial.hermite_e.hermegauss(num_points)
    return node, np.log(weight) - 0.5 * math.log(2 * math.pi)
