"""Resampling and roughening of particle sets.

A resampler draws ancestors: particle p has `P w_p` children in the mean. How far their number strays from
that is what resamplers differ in (Douc, Cappe and Moulines, "Comparison of resampling schemes for particle
filtering", 2005).
"""

import abc
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.core.random import RandomStreams
from torchdt.core.ranges import Checked, Share
from torchdt.core.weights import effective_sample_size, mean_and_covariance


class ResamplingDraws(NamedTuple):
    """Random numbers for N particle sets.

    Attributes:
        uniform: `(*batch, N, U)` on [0, 1), as many as the resampler needs.
        jitter: `(*batch, N, P, D)` standard normal.
    """

    uniform: Tensor
    jitter: Tensor


@runtime_checkable
class Resampler(Protocol):
    """Makes particle sets of even weights out of others; see `BaseResampler`, from which all but two come."""

    def num_uniforms(self, num_particles: int) -> int:
        """Number of uniform draws that ancestors of one set take."""
        ...

    def ancestors(self, log_weight: Tensor, uniform: Tensor) -> Tensor:
        """Ancestors of new particles, `(*batch, P)` int64.

        Args:
            log_weight: `(*batch, P)` normalised.
            uniform: `(*batch, num_uniforms(P))` draws on [0, 1).
        """
        ...

    def draw(
        self, streams: RandomStreams, num_sets: int, num_particles: int, entries: int
    ) -> ResamplingDraws:
        """Random numbers for sets of particles, always as many, whichever of them are resampled."""
        ...

    def resample(self, state: Tensor, log_weight: Tensor, draws: ResamplingDraws) -> tuple[Tensor, Tensor]:
        """New particles and log-weights.

        Args:
            state: `(*batch, N, P, D)`.
            log_weight: `(*batch, N, P)` normalised.
            draws: random numbers.
        """
        ...


@dataclass(frozen=True)
class BaseResampler(Checked, abc.ABC):
    """Resamples the sets of low effective sample size and roughens them; the others stay as they are.

    The weights keep their gradient, see `stop_gradient_weights`. A resampler of one's own says how ancestors
    are drawn (`num_uniforms`, `ancestors`).

    Attributes:
        below: resample where the effective sample size is below this share of the particles.
        roughening: kernel width after resampling, in standard deviations of the particle set, see `roughen`.
    """

    KEY: ClassVar[str] = "tracker.resampler"

    below: Share = 0.5
    roughening: Share = 0.1

    @abc.abstractmethod
    def num_uniforms(self, num_particles: int) -> int:
        """See `Resampler.num_uniforms`."""

    @abc.abstractmethod
    def ancestors(self, log_weight: Tensor, uniform: Tensor) -> Tensor:
        """See `Resampler.ancestors`."""

    def draw(
        self, streams: RandomStreams, num_sets: int, num_particles: int, entries: int
    ) -> ResamplingDraws:
        """See `Resampler.draw`."""
        uniform = streams.uniform(num_sets, self.num_uniforms(num_particles))
        return ResamplingDraws(uniform, streams.normal(num_sets, num_particles, entries))

    def resample(self, state: Tensor, log_weight: Tensor, draws: ResamplingDraws) -> tuple[Tensor, Tensor]:
        """See `Resampler.resample`."""
        poor = effective_sample_size(log_weight) < self.below * log_weight.shape[-1]
        old, old_weight = state[poor], log_weight[poor]
        ancestors = self.ancestors(old_weight, draws.uniform[poor])
        even = stop_gradient_weights(old_weight, ancestors)
        particles = old.gather(-2, ancestors[..., None].expand_as(old))
        particles = roughen(particles, even.detach(), draws.jitter[poor], self.roughening)
        return state.index_put((poor,), particles), log_weight.index_put((poor,), even)


@dataclass(frozen=True)
class Systematic(BaseResampler):
    """One draw places an even grid of levels: every number of children is `floor(P w)` or `ceil(P w)`."""

    def num_uniforms(self, num_particles: int) -> int:
        """One."""
        return 1

    def ancestors(self, log_weight: Tensor, uniform: Tensor) -> Tensor:
        """See `systematic_indices`."""
        return systematic_indices(log_weight, uniform[..., 0])


@dataclass(frozen=True)
class Multinomial(BaseResampler):
    """Independent draws from the weights (Gordon, Salmond and Smith 1993)."""

    def num_uniforms(self, num_particles: int) -> int:
        """One for each particle."""
        return num_particles

    def ancestors(self, log_weight: Tensor, uniform: Tensor) -> Tensor:
        """See `Resampler.ancestors`."""
        return invert_cumulative(log_weight, uniform)


@dataclass(frozen=True)
class Residual(BaseResampler):
    """`floor(P w)` children for certain, the others drawn from what is left (Liu and Chen 1998)."""

    def num_uniforms(self, num_particles: int) -> int:
        """One for each particle: how many are drawn depends on the weights."""
        return num_particles

    def ancestors(self, log_weight: Tensor, uniform: Tensor) -> Tensor:
        """See `residual_indices`."""
        return residual_indices(log_weight, uniform)


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


def residual_indices(log_weight: Tensor, uniform: Tensor) -> Tensor:
    """Ancestors of a residual resample (Liu and Chen 1998).

    Args:
        log_weight: `(*batch, P)` normalised.
        uniform: `(*batch, P)` uniform draws on [0, 1).

    Returns:
        `(*batch, P)` int64; index p occurs `floor(P w_p)` times at least.
    """
    num = log_weight.shape[-1]
    expected = num * log_weight.detach().exp()
    # Even weights must not fall below one by rounding.
    certain = (expected * (1 + 8 * torch.finfo(expected.dtype).eps)).floor()
    rest = (expected - certain).clamp_min(0.0)
    # Without a rest nothing is drawn from it.
    rest = torch.where(rest.sum(-1, keepdim=True) > 0, rest, expected)
    drawn = invert_cumulative(rest.log(), uniform)
    ends = certain.long().cumsum(-1)
    place = torch.arange(num, device=ends.device).expand_as(ends).contiguous()
    kept = torch.searchsorted(ends, place, right=True).clamp_max(num - 1)
    return torch.where(place < ends[..., -1:], kept, drawn)


def invert_cumulative(log_weight: Tensor, points: Tensor) -> Tensor:
    """Indices at which the cumulative weights reach given levels; uniform levels draw from the weights.

    Args:
        log_weight: `(*batch, P)`, up to a constant.
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
