"""BP with responses that are known only in part: what a model leaves of a strong source is no object."""

import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from oracles.arrays import complex_normal
from oracles.scenes import make_scene
from oracles.waveguide import configured

from torchdt.core.trees import select
from torchdt.field.build import waveguide
from torchdt.field.mismatch import MismatchedField
from torchdt.filter.bp.beliefs import background, initial_beliefs
from torchdt.filter.bp.schedule import Flooding, Sequential
from torchdt.filter.bp.update import update
from torchdt.filter.proposal.moved import diffuse_part, respond
from torchdt.filter.state import Objects
from torchdt.model.gamma_chain import uniform_prior
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.base import Noise

F64, C128 = torch.float64, torch.complex128
TONES, SNAPSHOTS, SHARE = (49.0, 148.0, 283.0), 3, 0.15
SOURCE, OTHER = (2812.0, 57.0), (3325.0, 41.0)
SCHEDULES = pytest.mark.parametrize("schedule", [Sequential(), Flooding()])


class Pair(NamedTuple):
    """Two potential objects, responses of their particles, noise and data."""

    prior: Objects
    response: torch.Tensor
    noise: Noise
    measurement: object


@pytest.fixture(scope="module")
def field() -> MismatchedField:
    return MismatchedField(
        waveguide(**configured(freqs=TONES), dtype=F64), torch.full((3,), SHARE, dtype=F64)
    )


@pytest.fixture(scope="module")
def grids() -> tuple[torch.Tensor, torch.Tensor]:
    """Particles `(400, 4)` around the source, and everywhere else but there."""
    near = torch.cartesian_prod(torch.linspace(2790, 2834, 20), torch.linspace(54, 60, 20)).double()
    far = torch.cartesian_prod(torch.arange(2200.0, 3600.0, 25), torch.arange(21.0, 101.0, 4)).double()
    far = far[((far[:, 0] - SOURCE[0]).abs() > 75) | ((far[:, 1] - SOURCE[1]).abs() > 12)]
    return tuple(torch.cat([grid, torch.zeros_like(grid)], -1) for grid in (near, far))


def scatter(field: MismatchedField, position: tuple[float, float], rng: torch.Generator) -> torch.Tensor:
    """A response `(I, M)` of the ensemble around the model."""
    state = torch.tensor(position, dtype=F64)
    value, vector = torch.linalg.eigh(field.diffuse(state))
    draw = complex_normal(rng, *value.shape) * value.clamp_min(0).sqrt()
    return field(state) + (vector @ draw[..., None])[..., 0]


def simulate(seed: int, field, *positions, snr_db: float = 20.0):
    """Snapshots of equal sources in noise whose variance is near one."""
    rng = torch.Generator().manual_seed(seed)
    z = complex_normal(rng, len(TONES), SNAPSHOTS, 21)
    for position in positions:
        amplitude = complex_normal(rng, len(TONES), SNAPSHOTS, 1) * (21 * 10 ** (snr_db / 10)) ** 0.5
        z = z + amplitude * scatter(field, position, rng)[:, None]
    return from_snapshots(z)


def make_pair(field, grids, measurement) -> Pair:
    """An object expected at the source and one that may be anywhere else."""
    size = max(len(grid) for grid in grids)
    states = [torch.cat([g, g[:1].expand(size - len(g), -1)]) for g in grids]
    weights = [torch.full((size,), -math.log(len(g)), dtype=F64) for g in grids]
    for weight, grid in zip(weights, grids, strict=True):
        weight[len(grid) :] = -torch.inf
    power, log_power = uniform_prior(torch.full((2, 3), 21 * 1000.0, dtype=F64), 24)
    prior = Objects(
        torch.stack(states),
        torch.stack(weights),
        power,
        log_power,
        torch.logit(torch.tensor([0.9, 1e-3], dtype=F64)),
        torch.zeros(2, dtype=torch.int64),
        torch.ones_like(weights[0]).expand(2, -1),
    )
    grid = torch.logspace(-0.5, 0.5, 11, dtype=F64).expand(3, -1)
    noise = Noise(grid, torch.full_like(grid, -math.log(11)))
    return Pair(prior, respond(field, prior.state), noise, measurement)


def existence(pair: Pair, diffuse=None) -> list[float]:
    initial = initial_beliefs(pair.prior, pair.response, pair.noise, diffuse)
    return torch.sigmoid(update(*pair, initial=initial).objects.log_odds).tolist()


@pytest.mark.parametrize("seed", range(4))
def test_what_the_model_leaves_of_a_strong_source_is_no_object(field, grids, seed):
    """The exact model takes a ghost for certain; with the diffuse part it is dismissed."""
    pair = make_pair(field, grids, simulate(seed, field, SOURCE))
    ghost = existence(pair._replace(response=respond(field.field, pair.prior.state)))
    found = existence(pair, diffuse_part(field, pair.prior.state, pair.prior.log_weight))
    assert ghost[0] > 0.99
    assert ghost[1] > 0.99
    assert found[0] > 0.99
    assert found[1] < 0.01


@pytest.mark.parametrize("seed", range(4))
def test_another_source_is_still_found(field, grids, seed):
    pair = make_pair(field, grids, simulate(seed, field, SOURCE, OTHER))
    found = existence(pair, diffuse_part(field, pair.prior.state, pair.prior.log_weight))
    assert min(found) > 0.99


def random_pair(seed: int):
    scene = make_scene(seed, (-12.0,), (16.0,), ((-30.0, -10.0), (-9.5, 20.0)))
    rng = torch.Generator().manual_seed(seed)
    root = complex_normal(rng, 2, 7, 8, 8)
    return scene, root @ root.mH / 64


@SCHEDULES
def test_a_share_of_zero_changes_nothing(schedule):
    scene, diffuse = random_pair(1)
    args = (scene.prior, scene.response, scene.noise, scene.measurement)
    plain = update(*args, schedule=schedule)
    initial = initial_beliefs(*args[:3], 0 * diffuse)
    found = update(*args, schedule=schedule, initial=initial)
    for a, b in zip((*found.objects, *found.noise), (*plain.objects, *plain.noise), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-10, atol=1e-10)
    for name in ("moment", "strength", "power"):
        torch.testing.assert_close(getattr(found, name), getattr(plain, name), rtol=1e-10, atol=1e-10)
    some = update(*args, schedule=schedule, initial=initial_beliefs(*args[:3], diffuse))
    assert (some.objects.log_odds - plain.objects.log_odds).abs().max() > 0.1


def test_schedules_agree_on_one_object():
    """With one object and one sweep there is no order; its own diffuse part is in both backgrounds."""
    scene, diffuse = random_pair(2)
    prior = Objects(*(t[:1] for t in scene.prior))
    initial = initial_beliefs(prior, scene.response[:1], scene.noise, diffuse[:1])
    args = (prior, scene.response[:1], scene.noise, scene.measurement)
    first, second = (update(*args, sweeps=1, schedule=s, initial=initial) for s in (Sequential(), Flooding()))
    for a, b in zip(first.objects, second.objects, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(first.moment, second.moment)
    torch.testing.assert_close(first.power, second.power)


@pytest.mark.parametrize("with_found", [False, True])
def test_background_term_by_term(with_found):
    scene, diffuse = random_pair(3)
    beliefs = initial_beliefs(scene.prior, scene.response, scene.noise, diffuse)
    rng = torch.Generator().manual_seed(9)
    root = complex_normal(rng, 7, 8, 8)
    found = root @ root.mH
    heard = torch.ones(7, 8, dtype=F64)
    heard[2, 5] = 0
    data = scene.measurement._replace(present=heard)
    result = background(beliefs, data, torch.tensor(1), found if with_found else None).numpy()
    weight = scene.prior.log_weight[0].exp().numpy()
    for i in range(7):
        a = scene.response[0, i].numpy()
        moment = np.einsum("p,pm,pk->mk", weight, a, a.conj()) + diffuse[0, i].numpy()
        power = scene.prior.mean_power[:, i].numpy()
        expected = 0.1 * power[0] * moment + power[1] * diffuse[1, i].numpy()  # prior existence is 0.1
        if with_found:
            expected = expected + found[i].numpy()
        if i == 2:
            expected[5], expected[:, 5] = 0, 0
        expected = expected + scene.noise.mean[i].item() * np.eye(8)
        np.testing.assert_allclose(result[i], expected, rtol=1e-10, atol=1e-10)


class Nest(NamedTuple):
    """A tuple of tuples with a part that may be missing."""

    objects: Objects
    noise: Noise
    value: torch.Tensor
    diffuse: torch.Tensor | None


@pytest.mark.parametrize("with_diffuse", [False, True])
@pytest.mark.parametrize("batch", [(4,), (2, 3)])
def test_select_on_nested_tuples(batch, with_diffuse):
    rng = torch.Generator().manual_seed(6)

    def nest() -> Nest:
        def draw(*shape: int) -> torch.Tensor:
            return torch.randn(*batch, *shape, generator=rng)

        points = draw(2, 5, 4), draw(2, 5), draw(2, 3, 6), draw(2, 3, 6), draw(2), draw(2).long(), draw(2, 5)
        extra = draw(2, 3) if with_diffuse else None
        return Nest(Objects(*points), Noise(draw(3, 7), draw(3, 7)), draw(), extra)

    first, second = nest(), nest()
    condition = torch.rand(batch, generator=rng) < 0.5
    assert 0 < int(condition.sum()) < condition.numel()
    chosen = select(condition, first, second)
    assert type(chosen) is Nest
    assert type(chosen.objects) is Objects
    assert (chosen.diffuse is None) is not with_diffuse

    def leaves(tree: Nest) -> list[torch.Tensor]:
        return [*tree.objects, *tree.noise, tree.value, *([tree.diffuse] if with_diffuse else [])]

    for found, a, b in zip(leaves(chosen), leaves(first), leaves(second), strict=True):
        for at in np.ndindex(batch):
            assert torch.equal(found[at], (a if condition[at] else b)[at])
