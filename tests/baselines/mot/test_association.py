"""Loopy data association beside the sum over all associations."""

import pytest
import torch
from oracles.association import enumerate_associations
from torch import Tensor
from torch.nn.functional import softplus

from torchdt.baselines.mot.association import associate, association_probabilities

F64 = torch.float64


def problem(seed: int, *size: int, scale: float = 2.0, dtype: torch.dtype = F64) -> tuple[Tensor, Tensor]:
    """Log-weights `(*batch, N, 1 + M)` of known objects and `(*batch, M)` of points left over."""
    rng = torch.Generator().manual_seed(seed)
    *batch, num, points = size
    legacy = scale * torch.randn(*batch, num, 1 + points, generator=rng, dtype=F64)
    return legacy.to(dtype), softplus(scale * torch.randn(*batch, points, generator=rng, dtype=F64)).to(dtype)


def solve(legacy: Tensor, new: Tensor, tolerance: float = 1e-12) -> tuple[Tensor, Tensor]:
    """Probabilities as the enumeration gives them."""
    messages = associate(legacy, new, tolerance, 10_000)
    free = torch.sigmoid(new - messages.to_new)
    return association_probabilities(legacy, messages), free


@pytest.mark.parametrize("scale", [1.0, 5.0, 20.0])
@pytest.mark.parametrize(("num", "points"), [(1, k) for k in range(1, 6)] + [(k, 1) for k in range(2, 6)])
def test_exact_for_one_object_or_one_point(num, points, scale):
    for seed in range(5):
        case = problem(seed, num, points, scale=scale)
        for found, expected in zip(solve(*case), enumerate_associations(*case), strict=True):
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("scale", "bound"), [(1.0, 0.06), (2.0, 0.14), (4.0, 0.2), (8.0, 0.2)])
def test_error_of_the_approximation(scale, bound):
    """Largest error of a probability over 48 problems of 2 to 5 objects and points; 0.05, 0.11, 0.17 and 0.16
    were found over 150. Most problems are far better: the median of the largest error stays below 0.01."""
    errors = []
    for seed in range(48):
        case = problem(seed, 2 + seed % 4, 2 + seed // 4 % 4, scale=scale)
        found, expected = solve(*case), enumerate_associations(*case)
        errors.append(max((f - e).abs().max().item() for f, e in zip(found, expected, strict=True)))
    assert max(errors) < bound
    assert sorted(errors)[24] < 0.01


def test_two_objects_that_claim_the_same_two_points():
    """The hardest case: exactly, an object is without a point in 0.5 %; belief propagation says 3.5 %."""
    legacy, new = torch.tensor([[-2.3, 3.0, 3.0]] * 2, dtype=F64), torch.zeros(2, dtype=F64)
    found, expected = solve(legacy, new)[0], enumerate_associations(legacy, new)[0]
    torch.testing.assert_close(found, expected, rtol=0, atol=0.04)
    torch.testing.assert_close(found[:, 1], found[:, 2])


def test_messages_are_a_fixed_point():
    """Of the equations as the paper writes them, without logarithms."""
    legacy, new = problem(3, 4, 6, 5)
    messages = associate(legacy, new, 1e-13, 10_000)
    beta, xi, v = legacy.exp(), new.exp(), messages.to_object.exp()
    claimed = beta[..., 1:] * v
    phi = beta[..., 1:] / (beta[..., :1] + claimed.sum(-1, keepdim=True) - claimed)
    torch.testing.assert_close(messages.to_new, phi.sum(-2).log())
    torch.testing.assert_close(v, 1 / (xi[..., None, :] + phi.sum(-2, keepdim=True) - phi))


def test_iteration_stops_at_the_tolerance_or_at_the_limit():
    """One more iteration changes no message by more than the tolerance, and some message by a good part."""
    legacy, new = problem(4, 5, 5, scale=4.0)
    best = associate(legacy, new, 1e-13, 10_000).to_object
    errors = [(associate(legacy, new, t, 10_000).to_object - best).abs().max() for t in (1e-1, 1e-4, 1e-7)]
    assert 1e-4 < errors[0] < 1.0
    assert 1e-7 < errors[1] < 1e-3
    assert errors[2] < 1e-6
    limited = [associate(legacy, new, 1e-13, n).to_object for n in (1, 2)]
    assert (limited[0] - limited[1]).abs().max() > 1e-2


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_what_is_not_there_changes_nothing(dtype):
    legacy, new = problem(5, 3, 4, dtype=dtype)
    padded = torch.full((5, 7), -torch.inf, dtype=dtype)
    padded[:, 0] = 0.0
    padded[:3, :5] = legacy
    more = torch.cat([new, torch.zeros(2, dtype=dtype)])
    found, free = solve(padded, more, 1e-5)
    expected, expected_free = solve(legacy, new, 1e-5)
    torch.testing.assert_close(found[:3, :5], expected)
    torch.testing.assert_close(free[:4], expected_free)
    assert found[3:, 0].eq(1).all()
    assert found[:, 5:].eq(0).all()
    assert free[4:].eq(1).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_batch_elements_do_not_depend_on_each_other(dtype):
    """At a coarse tolerance, so that an element that went on iterating with the others would show it."""
    legacy, new = problem(6, 2, 3, 4, 5, scale=3.0, dtype=dtype)
    legacy = legacy * torch.linspace(0.1, 3, 6, dtype=dtype).reshape(2, 3, 1, 1)
    together, further = associate(legacy, new, 0.05, 1000), associate(legacy, new, 1e-5, 1000)
    assert (together.to_object - further.to_object).abs().amax((-1, -2)).max() > 1e-3
    close = {"rtol": 0, "atol": 1e-5 if dtype == torch.float32 else 1e-12}
    for b in torch.cartesian_prod(torch.arange(2), torch.arange(3)):
        at = tuple(b)
        alone = associate(legacy[at], new[at], 0.05, 1000)
        torch.testing.assert_close(together.to_object[at], alone.to_object, **close)
        torch.testing.assert_close(together.to_new[at], alone.to_new, **close)


@pytest.mark.parametrize("scale", [100.0, 1000.0])
def test_weights_beyond_the_range_of_single_precision(scale):
    """They decide the association; which one is best the sum over all associations tells."""
    for seed in range(10):
        legacy, new = problem(seed, 4, 4, scale=scale)
        found, free = solve(legacy.float(), new.float(), 1e-5)
        expected, _ = enumerate_associations(legacy, new)
        assert found.isfinite().all()
        assert free.isfinite().all()
        torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-3)


def test_without_points_or_objects():
    found, free = solve(torch.zeros(2, 3, 1, dtype=F64), torch.zeros(2, 0, dtype=F64))
    assert found.eq(1).all()
    assert free.shape == (2, 0)
    found, free = solve(torch.zeros(2, 0, 4, dtype=F64), torch.zeros(2, 3, dtype=F64))
    assert found.shape == (2, 0, 4)
    assert free.eq(1).all()
