import math

import pytest
import torch

from torchdt.core.random import RandomStreams
from torchdt.core.resampling import (
    BaseResampler,
    Multinomial,
    Resampler,
    Residual,
    Systematic,
    invert_cumulative,
    roughen,
    scale_tril,
    stop_gradient_weights,
    systematic_indices,
)
from torchdt.core.weights import effective_sample_size, mean_and_covariance

F64 = torch.float64
RESAMPLERS = pytest.mark.parametrize("kind", [Systematic, Multinomial, Residual])


def random_weight(seed: int, *shape: int) -> torch.Tensor:
    rng = torch.Generator().manual_seed(seed)
    return (2 * torch.randn(shape, generator=rng, dtype=torch.float64)).softmax(-1)


def counts(indices: torch.Tensor, number: int) -> torch.Tensor:
    return torch.nn.functional.one_hot(indices, number).sum(-2)


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.999])
def test_counts_are_floor_or_ceiling(offset):
    weight = random_weight(1, 20, 50)
    indices = systematic_indices(weight.log(), torch.full((20,), offset, dtype=torch.float64))
    assert (indices.diff(dim=-1) >= 0).all()
    found, expected = counts(indices, 50), 50 * weight
    assert (found >= (expected - 1e-9).floor()).all()
    assert (found <= (expected + 1e-9).ceil()).all()


def test_counts_are_unbiased_over_the_offset():
    """The mean over a fine grid of offsets is an integral, so no chance is involved."""
    weight = random_weight(2, 30)
    offset = (torch.arange(20000, dtype=torch.float64) + 0.5) / 20000
    indices = systematic_indices(weight.log().expand(20000, -1), offset)
    torch.testing.assert_close(counts(indices, 30).double().mean(0), 30 * weight, rtol=0, atol=1e-3)


@pytest.mark.parametrize("heavy", [0, 3, 7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_one_heavy_particle_takes_all(heavy, dtype):
    log_weight = torch.full((8,), -torch.inf, dtype=dtype)
    log_weight[heavy] = 0.0
    for offset in (0.0, 0.5, 0.999):
        assert systematic_indices(log_weight, torch.tensor(offset, dtype=dtype)).eq(heavy).all()


@pytest.mark.parametrize("particles", [8, 1000])
def test_particles_of_zero_weight_are_never_drawn(particles):
    """Also at either end, and at the smallest and largest offset that single precision can draw."""
    log_weight = torch.full((particles,), -torch.inf)
    log_weight[2:-2] = torch.zeros(particles - 4).log_softmax(-1)
    for offset in (0.0, 0.5, 1 - 2**-24):
        indices = systematic_indices(log_weight, torch.tensor(offset))
        assert indices.min() >= 2
        assert indices.max() < particles - 2


def test_levels_fall_into_the_interval_of_their_particle():
    """Cumulative weights 0.25, 0.25, 0.75, 1: a level at an edge belongs to the next one with a weight."""
    log_weight = torch.tensor([0.25, 0.0, 0.5, 0.25], dtype=torch.float64).log()
    points = torch.tensor([0.0, 0.2499, 0.25, 0.5, 0.7499, 0.75, 0.9999, 1.0], dtype=torch.float64)
    assert invert_cumulative(log_weight, points).tolist() == [0, 0, 2, 2, 2, 3, 3, 3]
    backwards = invert_cumulative(log_weight.expand(2, 3, -1), points.flip(0).expand(2, 3, -1))
    assert backwards[1, 2].tolist() == [3, 3, 3, 2, 2, 2, 0, 0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_shares_of_a_fine_grid_of_levels_are_the_weights(dtype):
    """Any number of levels, in any order; a share is off by one level at most."""
    weight = random_weight(8, 2, 3, 30).to(dtype)
    order = torch.randperm(5000, generator=torch.Generator().manual_seed(1))
    points = ((order + 0.5) / 5000).to(dtype).expand(2, 3, -1)
    indices = invert_cumulative(weight.log(), points)
    share = counts(indices, 30).to(dtype) / 5000
    torch.testing.assert_close(share, weight, rtol=0, atol=1.01 / 5000)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_highest_level_finds_the_last_particle_with_a_weight(dtype):
    """Also where rounding leaves the sum of many weights beside one."""
    log_weight = torch.full((100_000,), -torch.inf, dtype=dtype)
    log_weight[7:-3] = -math.log(100_000 - 10)
    ends = invert_cumulative(log_weight, torch.tensor([0.0, 1.0], dtype=dtype))
    assert ends.tolist() == [7, 100_000 - 4]


def test_no_gradient_through_the_ancestors():
    log_weight = random_weight(1, 5).log().requires_grad_()
    assert not systematic_indices(log_weight, torch.tensor(0.2)).requires_grad


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_weights_after_resampling_are_even(dtype):
    log_weight = random_weight(5, 2, 3, 8).log().to(dtype).requires_grad_()
    found = stop_gradient_weights(
        log_weight, systematic_indices(log_weight, torch.full((2, 3), 0.4).to(dtype))
    )
    torch.testing.assert_close(found, torch.full((2, 3, 8), -math.log(8), dtype=dtype), rtol=0, atol=0)


def test_each_weight_after_resampling_has_the_gradient_of_its_ancestor():
    log_weight = random_weight(6, 2, 4).log().requires_grad_()
    ancestors = torch.tensor([[0, 0, 1, 3], [2, 2, 2, 3]])
    (found,) = torch.autograd.grad(stop_gradient_weights(log_weight, ancestors).sum(), log_weight)
    assert found.tolist() == [[2, 1, 0, 1], [0, 0, 3, 1]]


def test_weights_after_resampling_keep_the_gradient_of_expectations():
    """Of the expectation of a function, averaged over a fine grid of offsets: no chance is involved."""
    raw = torch.randn(30, generator=torch.Generator().manual_seed(7), dtype=torch.float64).requires_grad_()
    values = torch.linspace(-1, 3, 30, dtype=torch.float64).square()
    offset = (torch.arange(20000, dtype=torch.float64) + 0.5) / 20000
    log_weight = raw.log_softmax(-1)
    ancestors = systematic_indices(log_weight.expand(20000, -1), offset)
    even = stop_gradient_weights(log_weight.expand(20000, -1), ancestors)
    resampled = (even.exp() * values[ancestors]).sum(-1).mean()
    (found,) = torch.autograd.grad(resampled, raw, retain_graph=True)
    (expected,) = torch.autograd.grad((log_weight.exp() * values).sum(), raw)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-3 * expected.abs().max().item())


def test_roughening_keeps_mean_and_covariance():
    """Over 4000 jitters of one set; the errors of the averages stay below 5.2 standard errors (false
    alarm of 2e-7 for each of 4 means and 6 covariances)."""
    rng = torch.Generator().manual_seed(3)
    mix = torch.tensor([[1.0, 0.0, 0.0], [0.9, 0.1, 0.0], [20.0, 3.0, 5.0]], dtype=torch.float64)
    points = torch.randn(40, 3, generator=rng, dtype=torch.float64) @ mix.T + 3
    log_weight = random_weight(4, 40).log()
    draws = torch.randn(4000, 40, 3, generator=rng, dtype=torch.float64)
    jittered = roughen(points.expand(4000, -1, -1), log_weight.expand(4000, -1), draws, 0.5)
    mean, covariance = mean_and_covariance(points, log_weight)
    new_mean, _ = mean_and_covariance(jittered, log_weight.expand(4000, -1))
    assert ((new_mean.mean(0) - mean).abs() < 5.2 * new_mean.std(0) / 4000**0.5).all()
    # Second moment about the old mean: unlike the covariance of each set it is unbiased.
    centred = jittered - mean
    second = torch.einsum("bp,bpi,bpj->bij", log_weight.exp().expand(4000, -1), centred, centred)
    assert ((second.mean(0) - covariance).abs() < 5.2 * second.std(0) / 4000**0.5).all()
    assert (jittered - points).abs().mean() > 0.01  # it does move


def test_roughening_by_nothing_changes_nothing():
    points = torch.randn(2, 10, 4, generator=torch.Generator().manual_seed(1))
    found = roughen(points, torch.zeros_like(points[..., 0]).log_softmax(-1), torch.ones_like(points), 0.0)
    torch.testing.assert_close(found, points)


def test_factor_of_a_regular_covariance():
    root = torch.randn(3, 4, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    covariance = root @ root.mT + 0.1 * torch.eye(4)
    lower = scale_tril(covariance)
    torch.testing.assert_close(lower @ lower.mT, covariance)
    assert lower.triu(1).eq(0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", ["one point", "on a line", "one constant coordinate", "unlike units"])
def test_factor_of_a_singular_covariance(kind, dtype):
    rng = torch.Generator().manual_seed(1)
    points = torch.randn(50, 3, generator=rng, dtype=torch.float64)
    if kind == "one point":
        points[:] = torch.tensor([5e3, 54.0, -2.0])
    elif kind == "on a line":
        points = points[:, :1] * torch.tensor([1.0, -2.0, 0.5])
    elif kind == "one constant coordinate":
        points[:, 1] = 7.0
    else:
        points = points * torch.tensor([1e6, 1.0, 1e-6])
    points = points.to(dtype)
    _, covariance = mean_and_covariance(points, torch.zeros_like(points[:, 0]).log_softmax(-1))
    lower = scale_tril(covariance)
    assert lower.isfinite().all()
    deviation = covariance.diagonal().sqrt()
    error = (lower @ lower.mT - covariance).abs() / (deviation[:, None] * deviation).clamp_min(1e-30)
    assert error.max() < 1e3 * torch.finfo(dtype).eps


def two_sets() -> tuple[torch.Tensor, torch.Tensor]:
    """Particles `(2, 3, 6, 2)` of two sequences; of each first set one has nearly all the weight."""
    state = torch.randn(2, 3, 6, 2, generator=torch.Generator().manual_seed(1), dtype=F64)
    logits = torch.linspace(0, 0.5, 6, dtype=F64).repeat(2, 3, 1)
    logits[:, 0, 4] += 9.0
    return state, logits.log_softmax(-1)


def resample(resampler: Resampler, state: torch.Tensor, log_weight: torch.Tensor):
    streams = RandomStreams.from_seeds([1, 2], (2,), F64)
    found = resampler.resample(state, log_weight, resampler.draw(streams, *state.shape[-3:]))
    return *found, streams


@RESAMPLERS
def test_only_sets_of_few_effective_particles_are_resampled(kind):
    state, log_weight = two_sets()
    found, even, _ = resample(kind(below=0.5, roughening=0.0), state, log_weight)
    assert torch.equal(found[:, 1:], state[:, 1:])
    assert torch.equal(even[:, 1:], log_weight[:, 1:])
    assert (found[:, 0, :, None] == state[:, 0, None]).all(-1).any(-1).all()  # copies of the old ones
    torch.testing.assert_close(even[:, 0], torch.full((2, 6), -math.log(6), dtype=F64))


def test_the_share_of_effective_particles_decides():
    state, log_weight = two_sets()
    share = effective_sample_size(log_weight)[0, 1].item() / 6
    for below, resampled in ((share - 1e-6, False), (share + 1e-6, True)):
        _, even, _ = resample(Systematic(below=below, roughening=0.0), state, log_weight)
        assert (even[0, 1] != log_weight[0, 1]).any() == resampled


def test_resampled_particles_are_jittered():
    state, log_weight = two_sets()
    found, _, _ = resample(Systematic(below=1.0, roughening=0.1), state, log_weight)
    assert len(found[0, 1].unique(dim=0)) == 6
    distance = (found[0, 1][:, None] - state[0, 1]).norm(dim=-1)
    _, covariance = mean_and_covariance(state[0, 1], log_weight[0, 1])
    assert (distance.amin(-1) > 0).all()
    assert (distance.amin(-1) < covariance.diagonal().sum().sqrt()).all()


@RESAMPLERS
def test_as_many_numbers_are_drawn_whatever_is_resampled(kind):
    ends = [resample(kind(below=below), *two_sets())[-1].normal(3) for below in (0.0, 1.0)]
    assert torch.equal(*ends)


@RESAMPLERS
def test_resampled_weights_keep_the_gradient_of_their_ancestors(kind):
    """Without jitter the particles tell whose copies they are."""
    state, log_weight = two_sets()
    log_weight.requires_grad_()
    found, even, _ = resample(kind(below=1.0, roughening=0.0), state, log_weight)
    copies = (found[..., None, :] - state[..., None, :, :]).norm(dim=-1) < 1e-9
    assert copies.sum(-1).eq(1).all()
    (slope,) = torch.autograd.grad(even.sum(), log_weight)
    assert torch.equal(slope, copies.sum(-2).double())


def children(resampler: BaseResampler, weight: torch.Tensor, runs: int) -> torch.Tensor:
    """Numbers of children in independent resamples of the same weights, `(runs, P)`."""
    rng = torch.Generator().manual_seed(7)
    num = weight.shape[-1]
    uniform = torch.rand(runs, resampler.num_uniforms(num), generator=rng, dtype=weight.dtype)
    return counts(resampler.ancestors(weight.log().expand(runs, -1), uniform), num)


@RESAMPLERS
def test_numbers_of_children_have_the_mean_and_variance_of_their_scheme(kind):
    """4000 resamples of 30 weights. Means `P w` within 5.4 of their standard errors, normal: a false alarm of
    1e-5 over all of them. Variances `P w (1 - w)` of multinomial, `R v (1 - v)` of residual resampling, of
    which R are drawn with weights v, and `f (1 - f)` of systematic, f the fraction of `P w`."""
    weight, runs = random_weight(2, 30), 4000
    found = children(kind(), weight, runs).double()
    fraction = 30 * weight - (30 * weight).floor()
    drawn = fraction.sum()
    variance = {
        Systematic: fraction * (1 - fraction),
        Multinomial: 30 * weight * (1 - weight),
        Residual: fraction * (1 - fraction / drawn),
    }[kind]
    some = variance > 0.1  # of the others a few thousand resamples say too little
    assert some.sum() > 10
    assert ((found.mean(0) - 30 * weight)[some].abs() < 5.4 * (variance[some] / runs).sqrt()).all()
    # Counts of variance v are Poisson at most: the deviation of their variance is sqrt((1 / v + 2) / runs) of
    # it, and 0.3 is above five of these.
    torch.testing.assert_close(found.var(0)[some], variance[some], rtol=0.3, atol=0)


def test_residual_resampling_keeps_whole_numbers_of_children():
    weight = random_weight(1, 50)
    found = children(Residual(), weight, 200)
    assert (found >= (50 * weight - 1e-9).floor()).all()
    assert found.sum(-1).eq(50).all()
    assert (found > (50 * weight + 1e-9).ceil()).any()  # which systematic resampling would not give


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("number", [3, 7, 100, 1000])
def test_residual_resampling_of_even_weights_changes_nothing(number, dtype):
    weight = torch.zeros(number, dtype=dtype).softmax(-1)
    assert children(Residual(), weight, 5).eq(1).all()


@RESAMPLERS
@pytest.mark.parametrize("particles", [8, 1000])
def test_none_has_children_without_weight(kind, particles):
    log_weight = torch.full((particles,), -torch.inf)
    log_weight[2:-2] = torch.zeros(particles - 4).log_softmax(-1)
    for level in (0.0, 0.5, 1 - 2**-24):
        indices = kind().ancestors(log_weight, torch.full((kind().num_uniforms(particles),), level))
        assert indices.min() >= 2
        assert indices.max() < particles - 2
