"""Clusters of particle sets: found where there are modes, and only there."""

import math

import pytest
import torch
from torch import Tensor

from torchdt.core.partition import partition

F64 = torch.float64
SETS, PARTICLES = 20, 400


def skewed(white: Tensor, seed: int = 0) -> Tensor:
    """Sets of other scales and correlations, `(B, P, D)`: the answer must not depend on them."""
    rng, dim = torch.Generator().manual_seed(seed), white.shape[-1]
    mix = torch.randn(len(white), dim, dim, generator=rng, dtype=F64)
    return 100 + white @ (mix * torch.logspace(0, -3, dim, dtype=F64)).mT


def even(points: Tensor) -> Tensor:
    return torch.full(points.shape[:-1], -math.log(points.shape[-2]), dtype=points.dtype)


def modes(dim: int, places: Tensor, shares: list[float], seed: int = 1) -> tuple[Tensor, Tensor]:
    """Sets with modes `(B, K, dim)` of unit covariance, and the mode of each particle."""
    rng = torch.Generator().manual_seed(seed)
    mode = torch.multinomial(torch.tensor(shares), SETS * PARTICLES, True, generator=rng).reshape(SETS, -1)
    noise = torch.randn(SETS, PARTICLES, dim, generator=rng, dtype=F64)
    return noise + places.gather(1, mode[..., None].expand_as(noise)), mode


def directions(dim: int, seed: int = 2) -> Tensor:
    rng = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(SETS, 1, dim, generator=rng, dtype=F64), dim=-1)


def agree(label: Tensor, mode: Tensor) -> float:
    """Share of the particles in the cluster that is largest in their mode."""
    table = torch.stack([((label == k) & (mode == m)).sum(-1) for m in range(4) for k in range(4)], -1)
    return table.reshape(-1, 4, 4).amax(-1).sum().item() / mode.numel()


@pytest.mark.parametrize("dim", [1, 2, 4])
@pytest.mark.parametrize("kind", ["gaussian", "uniform", "cut in the middle", "weighted", "few"])
def test_a_set_of_one_mode_is_one_cluster(dim, kind):
    rng = torch.Generator().manual_seed(3)
    white = torch.randn(SETS, PARTICLES, dim, generator=rng, dtype=F64)
    log_weight = even(white)
    if kind == "uniform":
        white = torch.special.ndtr(white)
    elif kind == "cut in the middle":
        white = white.abs()
    elif kind == "weighted":  # by target over proposal of twice the variance
        log_weight = (-0.5 * white.square().sum(-1)).log_softmax(-1)
    elif kind == "few":  # next to all the weight on a few particles
        log_weight = (-50 * white.square().sum(-1)).log_softmax(-1)
    for dtype in (F64, torch.float32):
        label, number = partition(skewed(white).to(dtype), log_weight.to(dtype), 4)
        assert number.eq(1).all()
        assert label.eq(0).all()


@pytest.mark.parametrize("dim", [1, 2, 4])
@pytest.mark.parametrize("share", [0.5, 0.79, 0.9])
def test_two_modes_in_any_direction(dim, share):
    """Six deviations apart, so that 0.3 % of the particles stray; at 0.79 the kurtosis is a Gaussian's."""
    axis = directions(dim)
    points, mode = modes(dim, torch.cat([-3 * axis, 3 * axis], 1), [share, 1 - share])
    label, number = partition(skewed(points), even(points), 4)
    assert number.eq(2).all()
    assert agree(label, mode) > 0.98


@pytest.mark.parametrize("dim", [1, 2, 4])
def test_three_modes_in_a_line(dim):
    axis = directions(dim)
    points, mode = modes(dim, torch.cat([-20 * axis, 0 * axis, 20 * axis], 1), [0.5, 0.3, 0.2])
    label, number = partition(skewed(points), even(points), 4)
    assert number.eq(3).all()
    assert agree(label, mode) == 1


def test_no_more_clusters_than_asked_for():
    axis = directions(2)
    points, _ = modes(2, torch.cat([-20 * axis, 0 * axis, 20 * axis], 1), [0.5, 0.3, 0.2])
    for most in (1, 2):
        label, number = partition(points, even(points), most)
        assert number.eq(most).all()
        assert label.amax(-1).eq(most - 1).all()


def test_a_set_does_not_depend_on_the_others():
    """One mode, two and three in a batch, and sets of one particle and of equal ones."""
    axis = directions(2)[:1]
    rng = torch.Generator().manual_seed(4)
    noise = torch.randn(5, PARTICLES, 2, generator=rng, dtype=F64)
    at = torch.arange(PARTICLES) % 6
    noise[1] += (at % 2)[:, None] * 20 * axis[0]
    noise[2] += (at % 3)[:, None] * 20 * axis[0]
    noise[4] = noise[4, :1]
    log_weight = even(noise)
    log_weight[3] = torch.where(at == at, -torch.inf, log_weight[3]).index_fill(0, torch.tensor([7]), 0.0)
    together = partition(noise, log_weight, 4)
    assert together[1].tolist() == [1, 2, 3, 1, 1]
    for b in range(5):
        alone = partition(noise[b], log_weight[b], 4)
        assert alone[1] == together[1][b]
        assert alone[0].equal(together[0][b])
