"""A scalar linear-Gaussian model: its exact likelihood, and a bootstrap particle filter from library parts.

`x' = PHI x + sqrt(q) v`, `y = x + sqrt(r) e`, `x_0 ~ N(0, 1)`, with v and e standard normal. Parameters are
`log q` and `log r`.
"""

import math
from collections.abc import Callable

import torch
from torch import Generator, Tensor

from torchdt.core.resampling import systematic_indices
from torchdt.core.weights import normalise
from torchdt.model.motion.driving import Gradient, drive

PHI = 0.9


def simulate(steps: int, q: float, r: float, rng: Generator) -> Tensor:
    """Observations `(steps,)`."""
    x, *driving = torch.randn(steps + 1, generator=rng, dtype=torch.float64)
    noise = torch.randn(steps, generator=rng, dtype=torch.float64)
    states = [x := PHI * x + q**0.5 * v for v in driving]
    return torch.stack(states) + r**0.5 * noise


def kalman_log_likelihood(observed: Tensor, log_q: Tensor, log_r: Tensor) -> Tensor:
    """Exact log-likelihood of `(T,)` observations by the prediction-error decomposition."""
    mean, variance = torch.zeros_like(log_q), torch.ones_like(log_q)
    total = torch.zeros_like(log_q)
    for y in observed:
        mean, variance = PHI * mean, PHI**2 * variance + log_q.exp()
        innovation = variance + log_r.exp()
        total = total - 0.5 * ((y - mean) ** 2 / innovation + (2 * math.pi * innovation).log())
        gain = variance / innovation
        mean, variance = mean + gain * (y - mean), (1 - gain) * variance
    return total


def kalman_filter(
    observed: Tensor, mean: Tensor, covariance: Tensor, F: Tensor, Q: Tensor, r: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Kalman filter of a state `x' = F x + v` whose first entry is observed in noise of variance r.

    Args:
        observed: `(T,)`.
        mean, covariance: `(D,)` and `(D, D)` before the first prediction.
        F, Q: `(D, D)` transition, and covariance of v.
        r: variance of the observations.

    Returns:
        Means `(T, D)` and covariances `(T, D, D)` given the observations so far, and log evidences `(T,)`.
    """
    means, covariances, evidences = [], [], []
    for y in observed:
        mean, covariance = F @ mean, F @ covariance @ F.mT + Q
        innovation, gain = covariance[0, 0] + r, covariance[:, 0] / (covariance[0, 0] + r)
        evidences.append(-0.5 * ((y - mean[0]) ** 2 / innovation + (2 * math.pi * innovation).log()))
        mean, covariance = mean + gain * (y - mean[0]), covariance - gain[:, None] * covariance[0]
        means.append(mean)
        covariances.append(covariance)
    return torch.stack(means), torch.stack(covariances), torch.stack(evidences)


def exact_score(observed: Tensor, theta: Tensor) -> Tensor:
    """Gradient of the exact log-likelihood in `(log q, log r)`, `(2,)`."""
    theta = theta.clone().requires_grad_()
    return torch.autograd.grad(kalman_log_likelihood(observed, *theta), theta)[0]


def filter_log_likelihood(
    observed: Tensor,
    log_q: Tensor,
    log_r: Tensor,
    particles: int,
    rng: Generator,
    gradient: Gradient,
    after_resampling: Callable[[Tensor, Tensor], Tensor] | None,
) -> Tensor:
    """Estimates of the log-likelihood by independent particle filters, `(B,)`.

    Args:
        observed: `(T,)`, the same in all filters.
        log_q, log_r: `(B,)`, those of each filter.
        particles: P of each filter.
        rng: of all draws.
        gradient: of the driving noise.
        after_resampling: log-weights `(B, P)` from those before and from the ancestors; with None there is
            no resampling.
    """
    size = (len(log_q), particles)
    state = torch.randn(size, generator=rng, dtype=torch.float64)
    log_weight = torch.full_like(state, -math.log(particles))
    total = torch.zeros_like(log_q)
    for y in observed:
        draws = torch.randn(*size, 1, generator=rng, dtype=torch.float64)
        driving, log_ratio = drive(draws, log_q.exp()[:, None], gradient)
        state = PHI * state + driving[..., 0]
        r = log_r.exp()[:, None]
        log_likelihood = -0.5 * ((y - state) ** 2 / r + (2 * math.pi * r).log())
        log_weight, log_sum = normalise(log_weight + log_ratio + log_likelihood)
        total = total + log_sum
        if after_resampling is not None:
            ancestors = systematic_indices(
                log_weight, torch.rand(len(log_q), generator=rng, dtype=torch.float64)
            )
            state, log_weight = state.gather(-1, ancestors), after_resampling(log_weight, ancestors)
    return total
