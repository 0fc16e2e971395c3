"""One object that is seen among false points: its exact posterior, a Gaussian mixture."""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.distributions import MultivariateNormal


class Mixture(NamedTuple):
    """Posterior of an object.

    Attributes:
        log_weight: `(C,)` normalised.
        mean: `(C, D)`.
        covariance: `(C, D, D)`.
        log_odds: `()` of existence.
    """

    log_weight: Tensor
    mean: Tensor
    covariance: Tensor
    log_odds: Tensor

    @property
    def moments(self) -> tuple[Tensor, Tensor]:
        """Mean `(D,)` and covariance `(D, D)` of the mixture."""
        weight = self.log_weight.exp()
        mean = weight @ self.mean
        off = self.mean - mean
        return mean, (weight[:, None, None] * (self.covariance + off[:, :, None] * off[:, None, :])).sum(0)


def step(
    prior: Mixture,
    points: Tensor,
    *,
    step_s: float,
    driving_variance: Tensor,
    spread: Tensor,
    survival: float,
    detection_probability: float,
    clutter: float,
) -> Mixture:
    """Predict by constant-rate motion and sum over the origin of all points, without merging anything.

    Kalman filters of probabilistic data association (Bar-Shalom and Tse 1975), one for each history of
    associations; the number of components grows by 1 + M each step.

    Args:
        prior: of C components with D = 2 d.
        points: `(M, d)`.
        step_s: time step, s.
        driving_variance, spread: `(d,)`.
        survival, detection_probability: of the object.
        clutter: mean number of false points per unit of volume.
    """
    d = points.shape[-1]
    eye = torch.eye(d, dtype=points.dtype)
    F = torch.kron(torch.tensor([[1, step_s], [0, 1]], dtype=points.dtype), eye)
    W = torch.kron(torch.tensor([[step_s**2 / 2], [step_s]], dtype=points.dtype), eye)
    H = torch.cat([eye, torch.zeros_like(eye)], -1)
    mean, covariance = prior.mean @ F.T, F @ prior.covariance @ F.T + W @ torch.diag(driving_variance) @ W.T
    innovation = H @ covariance @ H.T + torch.diag(spread.square())
    gain = covariance @ H.T @ torch.linalg.inv(innovation)
    log_weights, means = [prior.log_weight + math.log(1 - detection_probability)], [mean]
    covariances = [covariance]
    for point in points:
        density = MultivariateNormal(mean @ H.T, innovation).log_prob(point)
        log_weights.append(prior.log_weight + math.log(detection_probability / clutter) + density)
        means.append(mean + (gain @ (point - mean @ H.T)[..., None])[..., 0])
        covariances.append(covariance - gain @ H @ covariance)
    log_weight = torch.cat(log_weights)
    evidence = log_weight.logsumexp(0)
    log_odds = torch.logit(survival * torch.sigmoid(prior.log_odds)) + evidence
    return Mixture(log_weight - evidence, torch.cat(means), torch.cat(covariances), log_odds)
