import math

import pytest
import torch

from torchdt.core.weights import (
    effective_sample_size,
    log_sum,
    mean_and_covariance,
    normalise,
    standard_deviation,
)


@pytest.mark.parametrize("offset", [-1e6, -1e3, 0.0, 1e3, 1e6])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weights_add_up_to_one_at_any_offset(offset, dtype):
    raw = 8 * torch.randn(5, 1000, generator=torch.Generator().manual_seed(1), dtype=torch.float64) + offset
    log_weight, log_sum = normalise(raw.to(dtype))
    total = log_weight.double().exp().sum(-1)
    torch.testing.assert_close(total, torch.ones_like(total), rtol=1e-5, atol=0)
    given = raw.to(dtype).double()
    torch.testing.assert_close(log_sum.double(), torch.logsumexp(given, -1), rtol=1e-6, atol=1e-5)
    expected = (given - given.logsumexp(-1, keepdim=True)).exp()
    torch.testing.assert_close(log_weight.double().exp(), expected, rtol=1e-4, atol=1e-9)


def test_zero_weights():
    raw = torch.tensor(
        [[-math.inf, 1.0, 1.0], [-math.inf, -math.inf, -math.inf], [-math.inf, -1e30, -math.inf]]
    )
    log_weight, log_sum = normalise(raw)
    expected = torch.tensor([[0.0, 0.5, 0.5], [1 / 3, 1 / 3, 1 / 3], [0.0, 1.0, 0.0]])
    torch.testing.assert_close(log_weight.exp(), expected)
    torch.testing.assert_close(log_sum, torch.tensor([1 + math.log(2), -math.inf, -1e30]))


def test_gradient_is_the_softmax():
    raw = torch.randn(6, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).requires_grad_()
    (gradient,) = torch.autograd.grad(normalise(raw)[1], raw)
    torch.testing.assert_close(gradient, raw.softmax(-1))


def test_effective_sample_size():
    weight = torch.tensor([[0.25, 0.25, 0.25, 0.25], [0.0, 1.0, 0.0, 0.0], [0.5, 0.0, 0.25, 0.25]])
    torch.testing.assert_close(effective_sample_size(weight.log()), torch.tensor([4.0, 1.0, 1 / 0.375]))
    torch.testing.assert_close(
        effective_sample_size(torch.zeros_like(weight).log_softmax(-1)), torch.full((3,), 4.0)
    )


def test_moments_equal_the_loop():
    rng = torch.Generator().manual_seed(1)
    points = torch.randn(2, 6, 3, generator=rng).double()
    weight = torch.rand(2, 6, generator=rng).double()
    weight = weight / weight.sum(-1, keepdim=True)
    mean, covariance = mean_and_covariance(points, weight.log())
    for b in range(2):
        m = sum(weight[b, p] * points[b, p] for p in range(6))
        c = sum(weight[b, p] * torch.outer(points[b, p] - m, points[b, p] - m) for p in range(6))
        torch.testing.assert_close(mean[b], m)
        torch.testing.assert_close(covariance[b], c)


def test_standard_deviations_of_a_narrow_set_far_away_in_single_precision():
    """Half a metre at five kilometres: squares that are not centred first would be off by metres."""
    rng = torch.Generator().manual_seed(1)
    points = (5000 + 0.5 * torch.randn(3, 1000, 2, generator=rng, dtype=torch.float64)).float()
    log_weight = torch.rand(3, 1000, generator=rng).log_softmax(-1)
    expected = [
        torch.cov(p.double().T, correction=0, aweights=w.double().exp()).diagonal().sqrt().float()
        for p, w in zip(points, log_weight, strict=True)
    ]
    torch.testing.assert_close(
        standard_deviation(points, log_weight), torch.stack(expected), rtol=1e-5, atol=0
    )


def test_a_sum_of_nothing_has_no_derivative():
    weight = torch.tensor([[0.2, 0.0, 0.3], [0.0, 0.0, 0.0]], dtype=torch.float64).mT
    log_weight = weight.log().requires_grad_()
    found = log_sum(log_weight, -1)
    torch.testing.assert_close(found.exp(), weight.sum(-1))
    (gradient,) = torch.autograd.grad(found[[0, 2]].sum() + found[1].exp(), log_weight)
    torch.testing.assert_close(gradient, (weight > 0).double())
