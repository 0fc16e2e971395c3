"""Mixtures of Gaussians against PyTorch's, and weights of strata against integrals."""

import math

import torch
from torch.distributions import Categorical, MixtureSameFamily, MultivariateNormal

from torchdt.core.importance import Gaussian
from torchdt.core.mixture import GaussianMixture, cluster_moments, deal
from torchdt.core.weights import mean_and_covariance

F64 = torch.float64


def normal(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def mixture(*batch: int) -> GaussianMixture:
    """Three overlapping components of three entries; the last sequence lacks the third."""
    tril = normal(1, *batch, 3, 3, 3).tril(-1) + torch.eye(3, dtype=F64)
    log_weight = torch.tensor([0.6, 0.3, 0.1], dtype=F64).log().repeat(*batch, 1)
    log_weight[-1, 2] = -torch.inf
    return GaussianMixture(log_weight.log_softmax(-1), 2 * normal(2, *batch, 3, 3), tril)


def test_densities_of_components_add_up_to_that_of_the_mixture():
    density, points = mixture(2), normal(3, 2, 7, 3)
    each = torch.stack([density.log_prob(points, torch.full((2, 7), k)) for k in range(3)])
    parts = MultivariateNormal(density.mean, scale_tril=density.tril)
    reference = MixtureSameFamily(Categorical(density.log_weight.exp()), parts)
    torch.testing.assert_close(each.logsumexp(0), reference.log_prob(points.movedim(1, 0)).mT)
    marginal = density.marginal(2)
    parts = MultivariateNormal(density.mean[..., :2], (density.tril @ density.tril.mT)[..., :2, :2])
    reference = MixtureSameFamily(Categorical(density.log_weight.exp()), parts)
    each = torch.stack([marginal.log_prob(points[..., :2], torch.full((2, 7), k)) for k in range(3)])
    torch.testing.assert_close(each.logsumexp(0), reference.log_prob(points[..., :2].movedim(1, 0)).mT)


def test_particles_are_dealt_out_by_share():
    share = torch.tensor([[0.5, 0.3, 0.2, 0.0], [1.0, 0, 0, 0], [0.999, 1e-9, 0.0, 0.001]], dtype=F64)
    dealt = deal(share, 1000)
    assert dealt.size.tolist() == [[499, 301, 200, 0], [1000, 0, 0, 0], [997, 1, 0, 2]]
    for component, rank, count in zip(*dealt, strict=True):
        for k, number in enumerate(count.tolist()):
            assert rank[component == k].tolist() == list(range(number))
    assert deal(share, 3).size[0].tolist() == [1, 1, 1, 0], "none goes without"
    torch.testing.assert_close(deal(share.float(), 1000), dealt)


def test_weights_of_strata_are_unbiased_whatever_the_shares():
    """Mass, mean and second moment of a mixture by 100,000 particles from wider components, most of them from
    the wrong one. Each estimate is within 4.8 of its standard errors: false alarm of 1e-5 for six."""
    density, number = mixture(1), 100_000
    dealt = deal(torch.tensor([[0.2, 0.8, 0.0]], dtype=F64), number)
    wider = GaussianMixture(*density[:2], 1.5 * density.tril)
    points = wider.sample(normal(5, 1, number, 3), dealt.component)
    log_proposal = wider.log_prob(points, dealt.component) - wider.log_share(dealt.component)
    log_count = dealt.size.log().gather(-1, dealt.component)
    weight = (density.log_prob(points, dealt.component) - log_proposal - log_count).exp()
    mean = (density.log_weight.exp()[..., None] * density.mean).sum(-2)
    power = density.mean.square() + density.tril.square().sum(-1)
    exact = torch.cat(
        [torch.ones(1, 1, dtype=F64), mean, (density.log_weight.exp()[..., None] * power).sum(-2)[:, :2]], -1
    )
    terms = (
        torch.cat([torch.ones(1, number, 1, dtype=F64), points, points[..., :2].square()], -1)
        * weight[..., None]
    )
    variance = torch.zeros_like(exact)
    for k in range(2):
        part = terms[0, dealt.component[0] == k]
        variance += len(part) * part.var(0)
    assert ((terms.sum(-2) - exact).abs() < 4.8 * variance.sqrt()).all()


def two_modes(runs: int = 2) -> tuple[torch.Tensor, torch.Tensor]:
    points = normal(6, runs, 400, 2)
    points[..., 0] += torch.where(torch.arange(400) < 120, 20.0, -20.0)
    return points, (0.3 * normal(7, runs, 400)).log_softmax(-1)


def test_clusters_have_the_moments_of_their_particles():
    points, log_weight = two_modes()
    found = cluster_moments(points, log_weight, 4)
    assert found.log_weight.shape == (2, 2)
    for k, members in enumerate((slice(120, None), slice(0, 120))):
        k = int(found.mean[0, 0, 0] > 0) ^ k
        share = log_weight[:, members].logsumexp(-1)
        torch.testing.assert_close(found.log_weight[:, k], share)
        moments = mean_and_covariance(points[:, members], log_weight[:, members] - share[:, None])
        torch.testing.assert_close((found.mean[:, k], found.covariance[:, k]), moments)


def test_one_cluster_has_the_moments_of_the_set():
    """Also beside a set of two modes, and so has its gradient."""
    points, log_weight = two_modes()
    points[0] = normal(8, 400, 2)
    log_weight.requires_grad_()
    log_share, mean, covariance = cluster_moments(points, log_weight, 4)
    assert log_share[0].tolist() == [0.0, -math.inf] or abs(log_share[0, 0]) < 1e-12
    expected = mean_and_covariance(points[0], log_weight[0])
    torch.testing.assert_close((mean[0, 0], covariance[0, 0]), expected)
    slopes = [
        torch.autograd.grad(m.sum() + c.sum(), log_weight, retain_graph=True)[0]
        for m, c in ((mean[0, 0], covariance[0, 0]), expected)
    ]
    centred = [slope[0] - log_weight[0].exp() * slope[0].sum() for slope in slopes]
    torch.testing.assert_close(*centred)


def test_gradient_of_shares_and_moments_equals_finite_differences():
    points, log_weight = two_modes()
    points[0] = normal(8, 400, 2)
    raw = log_weight.detach().requires_grad_()

    def value(raw: torch.Tensor) -> torch.Tensor:
        log_share, mean, covariance = cluster_moments(points, raw.log_softmax(-1), 4)
        there = log_share.isfinite()
        return log_share[there].sum() + (mean.sin().sum(-1) + covariance.sin().sum((-2, -1)))[there].sum()

    (slope,) = torch.autograd.grad(value(raw), raw)
    towards = normal(9, 2, 400)
    with torch.no_grad():
        difference = (value(raw + 1e-6 * towards) - value(raw - 1e-6 * towards)) / 2e-6
    torch.testing.assert_close((slope * towards).sum(), difference, rtol=1e-6, atol=0)


def test_it_is_a_gaussian_where_there_is_one():
    mean, tril = normal(1, 2, 3), normal(2, 2, 3, 3).tril(-1) + torch.eye(3, dtype=F64)
    one = GaussianMixture(torch.zeros(2, 1, dtype=F64), mean[:, None], tril[:, None])
    component, draws = torch.zeros(2, 5, dtype=torch.int64), normal(3, 2, 5, 3)
    torch.testing.assert_close(one.sample(draws, component), Gaussian(mean, tril).sample(draws))
    torch.testing.assert_close(one.log_prob(draws, component), Gaussian(mean, tril).log_prob(draws))
