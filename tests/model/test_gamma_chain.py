import math

import pytest
import torch
from scipy.special import exp1, gammaincc, polygamma
from torch.distributions import Gamma

from torchdt.core.weights import weighted_mean
from torchdt.model.gamma_chain import (
    LEAST_SHAPE,
    predict_chain,
    predicted_uniform_prior,
    uniform_prior,
    uniform_prior_around,
)


def log_moments(values, log_weight):
    mean = weighted_mean(values.log(), log_weight)
    return mean, weighted_mean((values.log() - mean[..., None]).square(), log_weight)


@pytest.mark.parametrize("shape", [LEAST_SHAPE, 5.0, 1e2, 1e4])
@pytest.mark.parametrize("points", [2, 16, 64])
def test_mean_and_variance_of_the_logarithm_are_exact(shape, points):
    """A transition keeps the mean, and adds that of `log g` to the variance of the logarithm."""
    rng = torch.Generator().manual_seed(points)
    values = torch.rand(3, points, generator=rng).double() + 0.2
    log_weight = torch.randn(3, points, generator=rng).double().log_softmax(-1)
    variance = log_moments(values, log_weight)[1]
    predicted, predicted_weight = predict_chain(values, log_weight, shape)
    new_variance = log_moments(predicted, predicted_weight)[1]
    torch.testing.assert_close(predicted_weight.exp().sum(-1), torch.ones(3).double())
    mean, new_mean = weighted_mean(values, log_weight), weighted_mean(predicted, predicted_weight)
    torch.testing.assert_close(new_mean, mean, rtol=1e-12, atol=0)
    torch.testing.assert_close(new_variance, variance + float(polygamma(1, shape)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("points", [16, 64])
def test_the_mean_is_kept_for_a_long_time(points, dtype):
    """A hundred steps without data at the smallest shape: the belief widens, and remains one."""
    values = torch.ones(points, dtype=dtype)
    log_weight = torch.full((points,), -math.log(points), dtype=dtype)
    for _ in range(100):
        values, log_weight = predict_chain(values, log_weight, LEAST_SHAPE)
        assert weighted_mean(values, log_weight).item() == pytest.approx(1.0, rel=1e-2)
        assert (values > 0).all()


@pytest.mark.parametrize(
    "predict", [predict_chain, lambda v, w, c: predicted_uniform_prior(v.amax(-1), 9, c)]
)
@pytest.mark.parametrize("shape", [LEAST_SHAPE, 3.0, 100.0])
def test_gradients_against_finite_differences(predict, shape):
    values = torch.tensor([[0.5, 0.8, 1.3], [0.2, 2.0, 0.9]], dtype=torch.float64)
    log_weight = torch.tensor([[0.2, 0.5, 0.3], [0.1, 0.3, 0.6]], dtype=torch.float64).log()
    inputs = (values, log_weight, torch.tensor([[shape], [2 * shape]][0], dtype=torch.float64))
    torch.autograd.gradcheck(predict, tuple(t.requires_grad_() for t in inputs))


@pytest.mark.parametrize("points", [16, 64])
@pytest.mark.parametrize("shape", [LEAST_SHAPE, 1.5, 20.0, 100.0, 1e4])
@pytest.mark.parametrize("best", [1e-4, 0.3, 1.5])
def test_uniform_prior_after_one_transition(shape, points, best):
    """The density is `c / (c - 1) Q(c - 1, c v / maximum) / maximum`, with the regularised upper incomplete
    gamma function Q, for c = 1 the exponential integral. Its mean is kept, and likelihoods of six energies,
    from far below the maximum to near it, come out right."""
    maximum = torch.tensor([2.0], dtype=torch.float64)
    value, log_weight = predicted_uniform_prior(maximum, points, shape)
    assert log_weight.exp().sum().item() == pytest.approx(1.0)
    assert weighted_mean(value, log_weight).item() == pytest.approx(1.0, rel=1e-3)
    fine = torch.logspace(-9, 3, 100_001, dtype=torch.float64)
    half = fine.numpy() / 2
    above = gammaincc(shape - 1, shape * half) * shape / (shape - 1) if shape > 1 else exp1(half)

    def likelihood(v):
        return (best / v) ** 6 * torch.exp(6 * (1 - best / v))

    exact = torch.trapezoid(likelihood(fine) * torch.from_numpy(above) / 2, fine).log()
    found = weighted_mean(likelihood(value), log_weight).log()
    assert (found - exact).abs().max() < (0.02 if points == 64 else 0.25)


def test_uniform_prior_after_a_sharp_transition_is_still_uniform():
    """In single precision too, where `log g` is smaller than the rounding of its parts."""
    for dtype in (torch.float32, torch.float64):
        value, log_weight = predicted_uniform_prior(torch.tensor([2.0], dtype=dtype), 64, 1e12)
        assert weighted_mean(value, log_weight).item() == pytest.approx(1.0, rel=1e-5)
        assert log_weight[value < 1].exp().sum().item() == pytest.approx(0.5, abs=0.15)
        assert log_weight[value > 2.01].exp().sum().item() < 1e-6


@pytest.mark.parametrize("shape", [1e2, 1e4])
def test_one_transition_from_a_known_value(shape):
    """Mean kept, relative standard deviation 1 / sqrt(c): the moments of Gamma(c, c / previous)."""
    previous = torch.full((1,), 0.7, dtype=torch.float64)
    values, log_weight = predict_chain(previous.expand(16), torch.full((16,), -math.log(16)).double(), shape)
    mean = weighted_mean(values, log_weight)
    deviation = weighted_mean((values - mean).square(), log_weight).sqrt()
    assert mean.item() == pytest.approx(0.7, rel=1 / shape**2)
    assert (deviation / mean).item() == pytest.approx(shape**-0.5, rel=1 / shape)


def test_against_monte_carlo():
    """Mean, deviation and log-mean of a two-point belief after one step; z-scores below 5.2 (false alarm
    of 2e-7 for each of the three)."""
    shape, number = 30.0, 200_000
    previous = torch.tensor([0.8, 1.1], dtype=torch.float64)
    log_weight = torch.tensor([0.3, 0.7], dtype=torch.float64).log()
    torch.manual_seed(4)
    pick = (torch.rand(number) < 0.7).long()
    sample = Gamma(torch.tensor(shape).double(), shape / previous[pick]).sample()
    values, weight = predict_chain(
        torch.cat([previous] * 8), torch.cat([log_weight] * 8) - math.log(8), shape
    )
    for function in (lambda v: v, lambda v: v.square(), lambda v: v.log()):
        drawn = function(sample)
        error = drawn.mean() - weighted_mean(function(values), weight)
        # The log-normal stand-in for two Gammas is off by parts in a thousand at most.
        slack = 1e-3 * drawn.mean().abs()
        assert error.abs() < 5.2 * drawn.std() / number**0.5 + slack


def test_zero_weight_points_do_not_matter():
    values = torch.tensor([0.5, 1.0, 1e-30], dtype=torch.float64)
    log_weight = torch.tensor([0.5, 0.5, 0.0], dtype=torch.float64).log()
    three, two = (predict_chain(values[:n], log_weight[:n], 100.0) for n in (3, 2))
    assert weighted_mean(*three).item() == pytest.approx(0.75)
    torch.testing.assert_close(log_moments(*three)[1], log_moments(*two)[1])


@pytest.mark.parametrize("function", [torch.ones_like, torch.square, lambda v: torch.exp(-3 * v), torch.cos])
def test_uniform_prior_integrates_smooth_functions(function):
    maximum = torch.tensor([2.0, 0.01], dtype=torch.float64)
    points, log_weight = uniform_prior(maximum, 400)
    fine = maximum[:, None] * (torch.arange(20000) + 0.5) / 20000
    torch.testing.assert_close(
        weighted_mean(function(points), log_weight), function(fine).mean(-1), rtol=1e-3, atol=1e-5
    )


@pytest.mark.parametrize("points", [8, 16, 64])
def test_uniform_prior_reaches_down_seven_decades(points):
    values, log_weight = uniform_prior(torch.tensor(3.0), points)
    width = 7 * math.log(10) / points
    assert values[-1].item() == pytest.approx(3 * math.exp(-width / 2), rel=1e-5)
    assert values[0].item() == pytest.approx(3e-7 * math.exp(width / 2), rel=1e-4)
    assert log_weight.exp().sum().item() == pytest.approx(1.0)
    # Each point stands for a bin whose probability is proportional to its value.
    torch.testing.assert_close((log_weight - values.log()).diff(), torch.zeros(points - 1), atol=1e-5, rtol=0)


@pytest.mark.parametrize(("best", "snapshots"), [(0.3, 3), (0.02, 3), (1.5, 3), (0.3, 20)])
def test_uniform_prior_around_a_likelihood_integrates_it(best, snapshots):
    """Likelihood of a power from J exponential energies, `v^-J exp(-J best / v)`: 16 points, within 1 %."""
    maximum = torch.tensor([2.0], dtype=torch.float64)

    def likelihood(values):
        return (best / values) ** snapshots * torch.exp(snapshots * (1 - best / values))

    points, log_weight = uniform_prior_around(torch.tensor([best], dtype=torch.float64), maximum, 16)
    fine = maximum[:, None] * (torch.arange(200000) + 0.5) / 200000
    found = (log_weight.exp() * likelihood(points)).sum(-1)
    torch.testing.assert_close(found, likelihood(fine).mean(-1), rtol=1e-2, atol=0)
    # The wide grid of as many points misses a likelihood this narrow.
    wide, wide_weight = uniform_prior(maximum, 16)
    error = (wide_weight.exp() * likelihood(wide)).sum(-1) / likelihood(fine).mean(-1) - 1
    assert error.abs().item() > 0.03


def test_uniform_prior_around_covers_what_is_below_and_stops_at_the_maximum():
    maximum = torch.tensor([2.0, 2.0], dtype=torch.float64)
    points, log_weight = uniform_prior_around(torch.tensor([1.0, math.inf], dtype=torch.float64), maximum, 8)
    torch.testing.assert_close(log_weight.exp().sum(-1), torch.ones(2, dtype=torch.float64))
    assert (points < 2).all()
    far, far_weight = uniform_prior_around(torch.tensor([1e-3, 1e-3], dtype=torch.float64), maximum, 8)
    assert far.max() < 1e-3 * math.exp(4)
    torch.testing.assert_close(far_weight.exp().sum(-1), 1e-3 * math.exp(4) / maximum)


def test_tracking_in_inference_mode_does_not_spoil_a_later_gradient():
    """Both use one table of nodes; 21 points that no other test uses."""
    values = torch.rand(21, dtype=torch.float64) + 0.5
    log_weight = torch.full((21,), -math.log(21), dtype=torch.float64)
    with torch.inference_mode():
        predict_chain(values, log_weight, 100.0)
    shape = torch.tensor(100.0, dtype=torch.float64, requires_grad=True)
    predict_chain(values, log_weight, shape)[0].sum().backward()
    assert shape.grad is not None
    assert shape.grad.isfinite()
