"""Proposals adapted to a sharp likelihood: tempered importance sampling with a Gaussian.

At 30 dB and more the likelihood is a thousand times narrower than the prior, so particles drawn from the
prior all miss it. A few rounds of a small population find it: each round weights its sample by
`prior * likelihood^tau / proposal`, with the largest tempering tau that keeps enough effective samples,
and fits the Gaussian for the next (population Monte Carlo, Cappe et al. 2004, with tempering). The final
sample is weighted by `prior / proposal` exactly, so evidence and existence stay unbiased whatever the
Gaussian is.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torchdt.core.resampling import scale_tril
from torchdt.core.weights import effective_sample_size, mean_and_covariance, normalise

INFLATION = 2.0
"""Covariance of the proposal over that of the fitted target: heavier tails, bounded weights."""


class Density(Protocol):
    """A prior on positions that can be sampled and evaluated."""

    def sample(self, draws: Tensor) -> Tensor:
        """Map standard normal draws `(*batch, P, d)` to samples."""
        ...

    def log_prob(self, points: Tensor) -> Tensor:
        """Log-density of `(*batch, P, d)`, `(*batch, P)`."""
        ...


class Gaussian(NamedTuple):
    """Normal density with mean `(*batch, d)` and lower factor `(*batch, d, d)`."""

    mean: Tensor
    tril: Tensor

    def sample(self, draws: Tensor) -> Tensor:
        """Map standard normal draws `(*batch, P, d)` to samples."""
        return self.mean[..., None, :] + draws @ self.tril.mT

    def whiten(self, points: Tensor) -> Tensor:
        """The standard normal draws `(*batch, P, d)` of which points are the samples."""
        centred = points - self.mean[..., None, :]
        return torch.linalg.solve_triangular(self.tril.mT, centred, upper=True, left=False)

    def log_prob(self, points: Tensor) -> Tensor:
        """Log-density, `(*batch, P)`."""
        white = self.whiten(points)
        log_det = self.tril.diagonal(dim1=-2, dim2=-1).log().sum(-1)[..., None]
        return -0.5 * white.square().sum(-1) - log_det - 0.5 * points.shape[-1] * math.log(2 * math.pi)


class Box(NamedTuple):
    """Uniform density between the corners `low` and `high`, `(*batch, d)`."""

    low: Tensor
    high: Tensor

    def sample(self, draws: Tensor) -> Tensor:
        """Map standard normal draws `(*batch, P, d)` to samples."""
        low, high = self.low[..., None, :], self.high[..., None, :]
        # Rounding may carry the ends of the interval across the box.
        return torch.lerp(low, high, torch.special.ndtr(draws)).clamp(low, high)

    def log_prob(self, points: Tensor) -> Tensor:
        """Log-density, `(*batch, P)`; minus infinity outside."""
        inside = ((points >= self.low[..., None, :]) & (points <= self.high[..., None, :])).all(-1)
        log_volume = (self.high - self.low).log().sum(-1)[..., None]
        return torch.where(inside, -log_volume, -torch.inf)


class Mixture(NamedTuple):
    """Fitted Gaussian with a defensive share of the prior, sampled by fixed numbers from each."""

    prior: Density
    fitted: Gaussian
    share: float

    def sample(self, draws: Tensor) -> Tensor:
        """Map standard normal draws `(*batch, P, d)`; the first `share * P` follow the prior."""
        first, rest = draws.tensor_split([round(self.share * draws.shape[-2])], dim=-2)
        return torch.cat([self.prior.sample(first), self.fitted.sample(rest)], dim=-2)

    def log_prob(self, points: Tensor) -> Tensor:
        """Log-density of the mixture, `(*batch, P)`."""
        return torch.logaddexp(
            self.prior.log_prob(points) + math.log(self.share),
            self.fitted.log_prob(points) + math.log1p(-self.share),
        )


def fit(points: Tensor, log_weight: Tensor) -> Gaussian:
    """Inflated Gaussian with the moments of a weighted sample `(*batch, P, d)`.

    It is never narrower than the rounding of the points, or two equal points would be a singular fit.
    """
    mean, covariance = mean_and_covariance(points, log_weight)
    rounding = 8 * torch.finfo(mean.dtype).eps * points.abs().amax(-2)
    return Gaussian(mean, scale_tril(INFLATION * covariance + torch.diag_embed(rounding.square())))


def adapt(
    log_likelihood: Callable[[Tensor], Tensor],
    prior: Density,
    draws: Tensor,
    *,
    min_effective: float = 0.15,
    share: float = 0.1,
) -> tuple[Mixture, Tensor]:
    """Fit a proposal for `prior * likelihood`.

    Rounds go on until no tempering is left; a batch element that got there keeps its proposal, so
    that it does not depend on the others.

    Args:
        log_likelihood: maps positions `(*batch, S, d)` to `(*batch, S)`.
        prior: density of batch `(*batch,)`.
        draws: `(rounds, *batch, S, d)` standard normal.
        min_effective: effective sample size to keep in each round, as a share of S.
        share: of the prior in every proposal.

    Returns:
        The proposal, and `log E[likelihood]` under the prior by the sample of the last round, `(*batch,)`.
    """
    with torch.no_grad():
        proposal: Mixture | None = None
        log_evidence = torch.zeros_like(draws[0, ..., 0, 0])
        done = torch.zeros_like(log_evidence, dtype=torch.bool)
        for draw in draws:
            current: Density = prior if proposal is None else proposal
            points = current.sample(draw)
            log_prior = prior.log_prob(points)
            log_ratio = log_prior - current.log_prob(points)
            message = log_likelihood(points)
            log_weight, temper = _temper(log_ratio, message, min_effective * draw.shape[-2])
            fitted = fit(points, log_weight)
            log_evidence = torch.where(done, log_evidence, normalise(log_ratio + message)[1])
            if proposal is not None:
                keep = done[..., None]
                fitted = Gaussian(
                    torch.where(keep, proposal.fitted.mean, fitted.mean),
                    torch.where(keep[..., None], proposal.fitted.tril, fitted.tril),
                )
            proposal = Mixture(prior, fitted, share)
            done = done | (temper >= 1)
            if bool(done.all()):
                break
    assert proposal is not None
    return proposal, log_evidence - math.log(draws.shape[-2])


def _temper(log_ratio: Tensor, log_likelihood: Tensor, min_effective: float) -> tuple[Tensor, Tensor]:
    """Weights at the largest tempering in {1, 1/2, 1/4, ...} that keeps enough effective samples."""
    exponents = 0.5 ** torch.arange(24, dtype=log_ratio.dtype, device=log_ratio.device)
    shape = (-1, *(1 for _ in range(log_ratio.ndim)))
    finite = log_ratio.isfinite()
    tempered = exponents.reshape(shape) * torch.where(finite, log_likelihood, 0.0) + log_ratio
    log_weights, _ = normalise(tempered)
    enough = effective_sample_size(log_weights) >= min_effective
    # Where nothing suffices (a sample mostly outside the prior) the mildest tempering is the best guess.
    chosen = torch.where(enough.any(0), enough.int().argmax(0), len(exponents) - 1)
    log_weight = log_weights.gather(0, chosen[None, ..., None].expand(1, *log_ratio.shape)).squeeze(0)
    return log_weight, exponents[chosen]
