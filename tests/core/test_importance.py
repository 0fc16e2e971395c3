import math

import pytest
import torch
from torch.distributions import MultivariateNormal

from torchdt.core.importance import Box, Gaussian, Mixture, adapt
from torchdt.core.random import RandomStreams

F64 = torch.float64


def gaussian() -> Gaussian:
    mean = torch.tensor([[1.0, -2.0], [0.0, 5.0]], dtype=F64)
    tril = torch.tensor([[[2.0, 0.0], [1.0, 0.5]], [[0.1, 0.0], [-0.3, 4.0]]], dtype=F64)
    return Gaussian(mean, tril)


def box() -> Box:
    return Box(
        torch.tensor([[-1.0, 2.0], [0.0, 0.0]], dtype=F64), torch.tensor([[1.0, 5.0], [0.1, 30.0]], dtype=F64)
    )


def normal(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def test_gaussian_agrees_with_torch():
    density, draws = gaussian(), normal(1, 2, 7, 2)
    points = density.sample(draws)
    reference = MultivariateNormal(density.mean[:, None], scale_tril=density.tril[:, None])
    torch.testing.assert_close(density.log_prob(points), reference.log_prob(points))
    white = torch.linalg.solve_triangular(density.tril, (points - density.mean[:, None]).mT, upper=False).mT
    torch.testing.assert_close(white, draws)


def test_box_is_uniform():
    """Kolmogorov distance of the marginals against uniform: 1.36/sqrt(n) is the 5 % level, 2.6/sqrt(n)
    is exceeded with probability 3e-6 (times four marginals)."""
    density, number = box(), 20000
    points = density.sample(normal(2, 2, number, 2))
    share = (points - density.low[:, None]) / (density.high - density.low)[:, None]
    empirical = (torch.arange(number, dtype=F64) + 0.5) / number
    assert (share.sort(1).values - empirical[:, None]).abs().amax() < 2.6 / number**0.5
    volume = (density.high - density.low).prod(-1)
    torch.testing.assert_close(density.log_prob(points), -volume.log()[:, None].expand(-1, number))
    assert density.log_prob(density.high[:, None] + 1e-6).eq(-torch.inf).all()


@pytest.mark.parametrize("draw", [-9.0, 9.0])
def test_box_holds_its_extreme_samples(draw):
    """Single precision reaches such a draw about once in 1e7; a sample outside its own prior has no
    weight and no density ratio."""
    rng = torch.Generator().manual_seed(1)
    low = 100 * torch.randn(1000, 1, generator=rng)
    density = Box(low, low + 2.1 + torch.rand(1000, 1, generator=rng))
    assert density.log_prob(density.sample(torch.full((1000, 1, 1), draw))).isfinite().all()


def test_mixture_density_and_shares():
    density = Mixture(box(), gaussian(), 0.25)
    draws = normal(3, 2, 40, 2)
    points = density.sample(draws)
    torch.testing.assert_close(points[:, :10], box().sample(draws[:, :10]))
    torch.testing.assert_close(points[:, 10:], gaussian().sample(draws[:, 10:]))
    expected = 0.25 * box().log_prob(points).exp() + 0.75 * gaussian().log_prob(points).exp()
    torch.testing.assert_close(density.log_prob(points), expected.log())


def sharp_likelihood(width: torch.Tensor, peak: torch.Tensor, height: float):
    """A peak of log-height `height`, far narrower than the prior, with a side lobe e^-5 as high."""

    def log_likelihood(points: torch.Tensor) -> torch.Tensor:
        def lobe(centre):
            offset = (points - centre[..., None, :]) / width[..., None, :]
            return -0.5 * offset.square().sum(-1) - 0.05 * offset.pow(4).sum(-1)

        return height + torch.logaddexp(lobe(peak), lobe(peak + 6 * width) - 5)

    return log_likelihood


def quadrature(log_likelihood, prior, low, high, number: int = 1500) -> float:
    """Log of the integral of prior times likelihood over a rectangle that holds the peak."""
    axes = [
        a + (b - a) * (torch.arange(number, dtype=F64) + 0.5) / number for a, b in zip(low, high, strict=True)
    ]
    grid = torch.cartesian_prod(*axes)
    area = math.prod(b - a for a, b in zip(low, high, strict=True)) / number**2
    return (log_likelihood(grid) + prior.log_prob(grid)).logsumexp(-1).item() + math.log(area)


PRIORS = {
    "box": Box(torch.tensor([-1.0, -10.0], dtype=F64), torch.tensor([1.0, 30.0], dtype=F64)),
    "gaussian": Gaussian(
        torch.tensor([0.0, 10.0], dtype=F64), torch.tensor([[0.6, 0.0], [2.0, 9.0]], dtype=F64)
    ),
}


@pytest.mark.parametrize("kind", PRIORS)
@pytest.mark.parametrize("height", [0.0, 3e4])
def test_evidence_of_a_sharp_likelihood(kind, height):
    """Peak 1e4 times smaller than the prior. Over 20 seeds every estimate is within 30 % and their mean
    within 3 % of the quadrature, ten times its standard error here."""
    prior = PRIORS[kind]
    width, peak = torch.tensor([0.01, 0.2], dtype=F64), torch.tensor([0.31, 12.0], dtype=F64)
    log_likelihood = sharp_likelihood(width, peak, height)
    exact = quadrature(log_likelihood, prior, (peak - 8 * width).tolist(), (peak + 14 * width).tolist())
    streams = RandomStreams.from_seeds(range(20), (20,), F64)
    rounds, final = streams.normal(8, 200, 2), streams.normal(1000, 2)
    batched = type(prior)(*(t.expand(20, *t.shape) for t in prior))
    mixture, _ = adapt(log_likelihood, batched, rounds.movedim(1, 0))
    points = mixture.sample(final)
    log_weight = log_likelihood(points) + batched.log_prob(points) - mixture.log_prob(points)
    estimate = (log_weight.logsumexp(-1) - math.log(1000) - exact).exp()
    assert (estimate - 1).abs().max() < 0.3
    assert estimate.mean().item() == pytest.approx(1, abs=0.03)
    size = 1 / (log_weight.log_softmax(-1).exp().square().sum(-1))
    assert size.median() > 400


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_batch_element_does_not_depend_on_the_others(dtype):
    """A sharp peak, a blunt one that needs a single round, and none at all."""
    width = torch.tensor([[0.01, 0.2], [3.0, 60.0], [1e9, 1e9]], dtype=dtype)
    peak = torch.tensor([[0.31, 12.0], [0.0, 0.0], [0.0, 0.0]], dtype=dtype)
    box_ = Box(*(t.to(dtype).expand(3, -1) for t in PRIORS["box"]))
    rounds = RandomStreams.from_seeds([1, 2, 3], (3,), dtype).normal(6, 128, 2).movedim(1, 0)
    together, _ = adapt(sharp_likelihood(width, peak, 0.0), box_, rounds)
    for b in range(3):
        one = slice(b, b + 1)
        alone, _ = adapt(
            sharp_likelihood(width[one], peak[one], 0.0), Box(*(t[one] for t in box_)), rounds[:, one]
        )
        torch.testing.assert_close(together.fitted.mean[one], alone.fitted.mean)
        torch.testing.assert_close(together.fitted.tril[one], alone.fitted.tril)


def test_zero_likelihood_everywhere_does_not_break_it():
    mixture, _ = adapt(
        lambda points: torch.full_like(points[..., 0], -1e30), PRIORS["box"], normal(1, 3, 50, 2)
    )
    assert mixture.fitted.tril.isfinite().all()


def test_proposal_is_wider_than_its_target():
    """A Gaussian target in the plane: with twice its variance the weights are at most 2 / 0.9 of their mean,
    and 3/4 of the sample counts; a proposal narrower than the target has weights without a bound. Fitted to a
    few hundred points it comes near both."""
    prior = Box(torch.full((20, 2), -30.0, dtype=F64), torch.full((20, 2), 30.0, dtype=F64))
    streams = RandomStreams.from_seeds(range(20), (20,), F64)
    rounds, final = streams.normal(8, 200, 2), streams.normal(2000, 2)
    mixture, _ = adapt(lambda points: -0.5 * points.square().sum(-1), prior, rounds.movedim(1, 0))
    points = mixture.sample(final)
    log_weight = prior.log_prob(points) - mixture.log_prob(points) - 0.5 * points.square().sum(-1)
    weight = log_weight.softmax(-1)
    assert weight.amax() * 2000 < 5
    assert (1 / weight.square().sum(-1)).min() > 0.5 * 2000
