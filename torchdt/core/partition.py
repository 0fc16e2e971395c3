"""Weighted particle sets cut into clusters, where clusters describe them better than one Gaussian does.

A set is cut in two where two Gaussians describe it best, then its parts. A cut gains what the classification
likelihood does: with C the covariance of a set, C_k and w_k the covariances and shares of its two sides,
`log|C| / 2 - sum_k w_k (log|C_k| / 2 - log w_k)` nats per particle. A Gaussian cut at its mean loses 0.19 and
a uniform set gains nothing, whatever the number of particles; two equal modes with s deviations from each to
the middle gain `log(1 + s^2) / 2 - log 2`. A cut has to gain more than its `nu` additional numbers are worth
by chance, `nu log(n) / (2 n)` with n effective particles (integrated classification likelihood: Biernacki,
Celeux and Govaert, IEEE Trans. PAMI 22, 2000), and a margin for sets that are no Gaussian and have one mode.
"""

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchdt.core.importance import Gaussian
from torchdt.core.resampling import scale_tril
from torchdt.core.trees import take
from torchdt.core.weights import effective_sample_size, mean_and_covariance, normalise

MARGIN = 0.1
"""Nats per particle that a cut must gain: of a hundred half normal or uniform sets it cuts none."""

TURNS = 1
"""How often particles go to the side that makes them more probable: few are on the wrong one."""

FARTHEST = 100.0
"""Deviations: what lies beyond has a weight below 1e-4."""


@torch.no_grad()
def partition(points: Tensor, log_weight: Tensor, most: int) -> tuple[Tensor, Tensor]:
    """Clusters of weighted particles.

    Args:
        points: `(*batch, P, D)`.
        log_weight: `(*batch, P)` normalised.
        most: largest number of clusters.

    Returns:
        The cluster of each particle `(*batch, P)` int64, counted from zero, and their number `(*batch,)`.
    """
    size, dim = effective_sample_size(log_weight), points.shape[-1]
    price = MARGIN + 0.25 * (dim + 1) * (dim + 2) * size.log1p() / size
    label = torch.zeros_like(log_weight, dtype=torch.int64)
    labels, scores = [label], [torch.zeros_like(size)]
    if most == 1:
        return label, torch.ones_like(size, dtype=torch.int64)
    above, gain = (t.unsqueeze(size.ndim) for t in _cut(points, log_weight))
    for cluster in range(1, most):
        best, which = gain.max(-1)
        if not bool((best > 0).any()):
            break
        label = torch.where((label == which[..., None]) & take(above, which), cluster, label)
        labels.append(label)
        scores.append(scores[-1] + best - price)
        # Both sides of the cut, to be cut in their turn: where one mode of many is cut off that gains more.
        sides = torch.stack([which, torch.full_like(which, cluster)], -1)
        of_side = torch.where(label.unsqueeze(-2) == sides[..., None], log_weight.unsqueeze(-2), -torch.inf)
        new_above, new_gain = _cut(points.unsqueeze(-3), of_side)
        row = which[..., None, None].expand_as(new_above[..., :1, :])
        above = torch.cat([above.scatter(-2, row, new_above[..., :1, :]), new_above[..., 1:, :]], -2)
        gain = torch.cat([gain.scatter(-1, which[..., None], new_gain[..., :1]), new_gain[..., 1:]], -1)
        # Whatever the other sets of the batch need, what gains nothing ends here.
        gain = torch.where((best > 0)[..., None], gain, -torch.inf)
    chosen = torch.stack(scores, -1).argmax(-1)
    return take(torch.stack(labels, -2), chosen), chosen + 1


def _cut(points: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
    """Best cut of sets in two: which side, `(*batch, P)` bool, and what it gains, `(*batch,)`.

    Args:
        points: `(*batch, P, D)` or broadcastable to it.
        log_weight: `(*batch, P)`, minus infinity for what is not in the set; the gain is times their sum.
    """
    log_weight, log_mass = normalise(log_weight)
    weight, size = log_weight.exp(), effective_sample_size(log_weight)
    # In double precision: no other holds the condition of any covariance, and leaves a set that is white.
    exact = points.double().expand(*log_weight.shape, -1)
    mean, covariance = mean_and_covariance(exact, log_weight)
    centred = (exact - mean[..., None, :]).mT
    # Points that differ by their rounding alone lie on a lattice: that is no clusters.
    rounding = torch.diag_embed((8 * torch.finfo(points.dtype).eps * exact.abs().amax(-2)).square())
    white = torch.linalg.solve_triangular(scale_tril(covariance + rounding), centred, upper=False)
    white = white.to(points.dtype)
    white = torch.where(weight[..., None, :] > 0, white.clamp(-FARTHEST, FARTHEST), 0.0)
    above = _cut_along(_axes(white, weight) @ white, weight, size)
    for _ in range(TURNS):
        above = _more_probable(white, *_sides(white, weight, size, above))
    share, _, covariance = _sides(white, weight, size, above)
    gain = (torch.xlogy(share, share) - 0.5 * share * torch.logdet(covariance)).sum(-1)
    possible = (share > 0).all(-1) & log_mass.isfinite()
    return above, torch.where(possible, gain * log_mass.exp(), -torch.inf)


def _axes(white: Tensor, weight: Tensor) -> Tensor:
    """Directions in which a set may fall apart, `(*batch, D + 1, D)`.

    Eigenvectors of `E[|z|^2 z z^T]`, one of which is the discriminant of two clusters not yet told apart
    (Tyler, Critchley, Duembgen and Oja, J. R. Statist. Soc. B 71, 2009), and the direction of the skew
    `E[|z|^2 z]`: the former fail where one cluster has a fifth of the weight, the latter where each has half.
    """
    weighted = (weight * white.square().sum(-2))[..., None, :] * white
    skew = normalize(weighted.sum(-1, keepdim=True), dim=-2)
    return torch.cat([torch.linalg.eigh(weighted @ white.mT).eigenvectors, skew], -1).mT


def _cut_along(along: Tensor, weight: Tensor, size: Tensor) -> Tensor:
    """Which points lie above the best threshold on the best axis, `(*batch, A, P)` to `(*batch, P)` bool."""
    # Thresholds a quarter of a deviation apart, from -2 to 2: how many of them a point lies above.
    passed = (4 * along + 9).clamp(0, 17).to(torch.int64)
    moments = weight[..., None, None, :] * torch.stack([torch.ones_like(along), along, along.square()], -2)
    upper = moments.new_zeros(*moments.shape[:-1], 18)
    upper.scatter_add_(-1, passed[..., None, :].expand_as(moments), moments)
    upper = upper.flip(-1).cumsum(-1).flip(-1)
    share, first, second = torch.stack([upper[..., 1:], upper[..., :1] - upper[..., 1:]], -1).unbind(-3)
    share = share.clamp_min(1e-6)
    # What is missing of the variance of the set is rounding, of both sides alike.
    missing = 1 - upper[..., 2, :1, None]
    variance = (second / share - (first / share).square() + missing).clamp_min(0.0)
    count = size[..., None, None, None] * share
    variance = (count * variance + 2) / (count + 2)
    gain = (share * (share.log() - 0.5 * variance.log())).sum(-1)
    best = gain.flatten(-2).argmax(-1)
    return take(passed, best // 17) > (best % 17)[..., None]


def _sides(white: Tensor, weight: Tensor, size: Tensor, above: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Shares `(*batch, 2)`, means `(*batch, 2, D)` and covariances of what lies above a cut and below."""
    dim = white.shape[-2]
    eye = torch.eye(dim, dtype=white.dtype, device=white.device)
    sides = torch.stack([above, ~above], -2) * weight[..., None, :]
    share = sides.sum(-1)
    inner = share.clamp_min(1e-6)[..., None]
    mean = (sides @ white.mT) / inner
    scatter = (sides[..., None, :] * white[..., None, :, :]) @ white[..., None, :, :].mT
    missing = eye - scatter.sum(-3, keepdim=True)
    covariance = scatter / inner[..., None] - mean[..., :, None] * mean[..., None, :] + missing
    # A few particles have a small covariance by chance: draw it to that of the set by D + 1 particles more.
    count = (size[..., None] * share)[..., None, None]
    return share, mean, (count * covariance + (dim + 1) * eye) / (count + dim + 1)


def _more_probable(white: Tensor, share: Tensor, mean: Tensor, covariance: Tensor) -> Tensor:
    """Whether the first of two Gaussians with their shares is the more probable one, `(*batch, P)` bool."""
    log_prob = Gaussian(mean, scale_tril(covariance)).log_prob(white.mT.unsqueeze(-3))
    first, second = (share.log()[..., None] + log_prob).unbind(-2)
    return first > second
