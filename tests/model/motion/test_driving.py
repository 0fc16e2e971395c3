import math

import pytest
import torch
from oracles.linear_gaussian import exact_score, filter_log_likelihood, simulate
from torch.distributions import Normal

from torchdt.core.resampling import stop_gradient_weights
from torchdt.model.motion.driving import Reparameterised, Score, drive

pytestmark = pytest.mark.slow
F64 = torch.float64
STEPS, PARTICLES, RUNS, SEED = 50, 1000, 128, 1
THETA = torch.tensor([0.7, 0.2], dtype=F64).log()  # log q, log r; the data come from q = 1, r = 0.15


def cut_off(log_weight, ancestors):
    """Even weights without a gradient: the usual mistake."""
    return torch.full_like(log_weight, -math.log(log_weight.shape[-1]))


ESTIMATORS = {
    "cut off": (Reparameterised(), cut_off),
    "reparameterised": (Reparameterised(), stop_gradient_weights),
    "score": (Score(), stop_gradient_weights),
}


def observations(steps: int = STEPS) -> torch.Tensor:
    return simulate(steps, 1.0, 0.15, torch.Generator().manual_seed(4))


@pytest.fixture(scope="module")
def scores() -> dict[str, torch.Tensor]:
    """Score of every run by every estimator, (RUNS, 2)."""

    def score(gradient, after_resampling):
        theta = THETA.expand(RUNS, 2).clone().requires_grad_()
        rng = torch.Generator().manual_seed(SEED)
        total = filter_log_likelihood(
            observations(), *theta.unbind(-1), PARTICLES, rng, gradient, after_resampling
        )
        return torch.autograd.grad(total.sum(), theta)[0]

    return {name: score(*estimator) for name, estimator in ESTIMATORS.items()}


def bias(score: torch.Tensor) -> torch.Tensor:
    """Of the mean over the runs, in standard errors, (2,)."""
    return (score.mean(0) - exact_score(observations(), THETA)) / (score.std(0) / RUNS**0.5)


@pytest.mark.parametrize("name", ["score", "reparameterised"])
def test_score_of_a_particle_filter_is_that_of_the_kalman_filter(scores, name):
    """The seed is fixed: a fresh one fails this in one of eight cases, but exceeds five standard errors with
    a probability of 6e-6 (Student's t of 127 degrees of freedom, three distinct components)."""
    assert (bias(scores[name]).abs() < 2).all()


def test_cutting_weights_off_at_resampling_is_found_out(scores):
    """It is wrong by more than the whole score, and by 40 standard errors and more."""
    exact = exact_score(observations(), THETA)
    assert ((scores["cut off"].mean(0) - exact).abs() > exact.abs()).all()
    assert (bias(scores["cut off"]).abs() > 40).all()


def test_particles_that_stand_still_give_the_steadier_score(scores):
    """In the transition's parameter, the measurement being sharp: by nearly a factor of two."""
    still, moving = (scores[name].std(0)[0] for name in ("score", "reparameterised"))
    assert still < 0.75 * moving


def test_finite_differences_of_a_filter_without_resampling():
    """Common random numbers, so nothing but the parameters differs."""
    observed = observations(8)

    def total(theta):
        rng = torch.Generator().manual_seed(3)
        return filter_log_likelihood(observed, *theta.unbind(-1), 200, rng, Reparameterised(), None)

    theta = THETA.expand(3, 2).clone().requires_grad_()
    (found,) = torch.autograd.grad(total(theta).sum(), theta)
    for i in range(2):
        step = torch.zeros(2, dtype=F64)
        step[i] = 1e-5
        with torch.no_grad():
            expected = (total(theta + step) - total(theta - step)) / 2e-5
        torch.testing.assert_close(found[:, i], expected, rtol=1e-6, atol=0)
    assert found.abs().min() > 0.01  # a relative error means something


def normal_and_variance(dtype=F64):
    rng = torch.Generator().manual_seed(4)
    draws = torch.randn(3, 5, 2, generator=rng, dtype=F64)
    variance = torch.rand(3, 2, generator=rng, dtype=F64) + 0.1
    return draws.to(dtype), variance.to(dtype).requires_grad_()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("gradient", [Score(), Reparameterised()])
def test_noise_has_its_variance_and_the_ratio_is_one(gradient, dtype):
    draws, variance = normal_and_variance(dtype)
    noise, log_ratio = drive(draws, variance, gradient)
    assert noise.dtype == log_ratio.dtype == dtype
    assert log_ratio.shape == (3, 5)
    assert log_ratio.eq(0).all()
    for b in range(3):
        for d in range(2):
            torch.testing.assert_close(noise[b, :, d], draws[b, :, d] * variance[b, d] ** 0.5)


@pytest.mark.parametrize("gradient", [Score(), Reparameterised()])
def test_a_variance_without_batch_serves_all(gradient):
    draws, variance = normal_and_variance()
    alone = drive(draws, variance[0], gradient)
    for found, expected in zip(alone, drive(draws, variance[:1].expand(3, 2), gradient), strict=True):
        torch.testing.assert_close(found, expected)


def test_moving_particles_carry_the_gradient():
    draws, variance = normal_and_variance()
    noise, log_ratio = drive(draws, variance, Reparameterised())
    assert not log_ratio.requires_grad
    assert torch.autograd.gradcheck(lambda v: drive(draws, v, Reparameterised())[0], (variance,))
    (found,) = torch.autograd.grad(noise.sum(), variance)
    torch.testing.assert_close(found, 0.5 * draws.sum(1) / variance.sqrt())


def test_the_ratio_of_particles_that_stand_still_carries_their_score():
    draws, variance = normal_and_variance()
    noise, log_ratio = drive(draws, variance, Score())
    assert not noise.requires_grad
    cotangent = torch.linspace(-1, 2, 15, dtype=F64).reshape(3, 5)
    (found,) = torch.autograd.grad(log_ratio, variance, cotangent)
    log_density = Normal(0.0, variance[:, None].sqrt()).log_prob(noise).sum(-1)
    (expected,) = torch.autograd.grad(log_density, variance, cotangent)
    torch.testing.assert_close(found, expected)
