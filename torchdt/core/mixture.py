"""Mixtures of Gaussians: what describes a particle set of several modes, and strata to sample from it.

A mixture is sampled by strata: every component gets a number of the particles, and a particle of component k
drawn from a density `q_k` weighs `w_k N_k(x) / (n_k q_k(x))`. The sum of such weights times any function is
unbiased whatever the `n_k` and `q_k` are, and a particle can move with the moments of its component.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.importance import Gaussian
from torchdt.core.partition import partition
from torchdt.core.weights import mean_and_covariance, normalise


class GaussianMixture(NamedTuple):
    """Gaussians with weights.

    Attributes:
        log_weight: `(*batch, K)` normalised; minus infinity for a component that there is not.
        mean: `(*batch, K, D)`.
        tril: `(*batch, K, D, D)` lower factors of their covariances.
    """

    log_weight: Tensor
    mean: Tensor
    tril: Tensor

    @property
    def components(self) -> Gaussian:
        """The Gaussians, of batch `(*batch, K)`."""
        return Gaussian(self.mean, self.tril)

    def marginal(self, number: int) -> "GaussianMixture":
        """Of the first entries."""
        return GaussianMixture(self.log_weight, self.mean[..., :number], self.tril[..., :number, :number])

    def joined(self, other: "GaussianMixture | None") -> "GaussianMixture":
        """The components of both, whose weights add up to one; of this one if there is no other."""
        if other is None:
            return self
        dim = self.log_weight.ndim - 1
        return GaussianMixture(*(torch.cat(pair, dim) for pair in zip(self, other, strict=True)))

    def sample(self, draws: Tensor, component: Tensor) -> Tensor:
        """Map standard normal draws `(*batch, P, D)` to samples of the components `(*batch, P)`."""
        return of_component(self.components.sample(draws.unsqueeze(-3)), component)

    def log_prob(self, points: Tensor, component: Tensor) -> Tensor:
        """`log w_k + log N_k`, `(*batch, P)`, of points `(*batch, P, D)` and their components."""
        log_prob = self.components.log_prob(points.unsqueeze(-3))
        return self.log_share(component) + of_component(log_prob, component)

    def log_share(self, component: Tensor) -> Tensor:
        """`log w_k` of the components, `(*batch, P)`."""
        return self.log_weight.gather(-1, component)


class Moments(NamedTuple):
    """Clusters of a particle set.

    Attributes:
        log_weight: `(*batch, K)` log of the share of each; minus infinity where there are fewer.
        mean: `(*batch, K, D)`.
        covariance: `(*batch, K, D, D)`.
    """

    log_weight: Tensor
    mean: Tensor
    covariance: Tensor


def cluster_moments(points: Tensor, log_weight: Tensor, most: int) -> Moments:
    """Shares, means and covariances of the clusters of weighted particles, see `partition`.

    Together they have the mean and covariance of the set, and of one cluster they are these. The gradient is
    that in points and weights; which cluster a particle belongs to is a constant.

    Args:
        points: `(*batch, P, D)`.
        log_weight: `(*batch, P)` normalised.
        most: largest number of clusters; K is that of the set of most clusters.
    """
    label, number = partition(points, log_weight, most)
    cluster = torch.arange(int(number.max()), device=label.device)[:, None]
    members = torch.where(label.unsqueeze(-2) == cluster, log_weight.unsqueeze(-2), -torch.inf)
    within, log_share = normalise(members)
    return Moments(log_share, *mean_and_covariance(points.unsqueeze(-3), within))


def of_component(values: Tensor, component: Tensor) -> Tensor:
    """What belongs to the component of each particle: `(*batch, K, P, ...)` at `(*batch, P)`."""
    dim, rest = component.ndim, values.shape[component.ndim + 1 :]
    at = component.reshape(*component.shape, *(1 for _ in rest)).expand(*component.shape, *rest)
    return values.gather(dim - 1, at.unsqueeze(dim - 1)).squeeze(dim - 1)


class Strata(NamedTuple):
    """Particles dealt out to components.

    Attributes:
        component: `(*batch, P)` int64, of each particle.
        rank: `(*batch, P)` int64, of each particle among those of its component.
        size: `(*batch, K)` int64, number of particles of each component.
    """

    component: Tensor
    rank: Tensor
    size: Tensor


def deal(share: Tensor, number: int) -> Strata:
    """Deal particles out to components by their shares, one at least to each that has any.

    Args:
        share: `(*batch, K)`, sums to one; zero for a component that there is not, positive for the first.
        number: of particles P, not fewer than components.
    """
    present = share > 0
    spare = (number - present.sum(-1, keepdim=True)).clamp_min(0)
    end = (share.cumsum(-1) * spare).round().to(torch.int64) + present.cumsum(-1)
    particle = torch.arange(number, device=share.device).expand(*share.shape[:-1], number).contiguous()
    component = torch.searchsorted(end, particle, right=True).clamp_max(share.shape[-1] - 1)
    count = (component.unsqueeze(-2) == torch.arange(share.shape[-1], device=share.device)[:, None]).sum(-1)
    rank = particle - (count.cumsum(-1) - count).gather(-1, component)
    return Strata(component, rank, count)
