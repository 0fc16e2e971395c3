"""Joint configurations: what is drawn, and the probability it is said to have been drawn with."""

import math

import pytest
import scipy.stats
import torch
from oracles.scenes import SAME, make_scene, repeat
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.filter.bp.configurations import (
    DOUBT,
    Configurations,
    UniformDraws,
    draw_configurations,
    labellings,
    log_probability,
)
from torchdt.filter.bp.messages import ObjectBelief
from torchdt.filter.bp.update import update
from torchdt.filter.state import Objects
from torchdt.model.noise.base import Noise

F64 = torch.float64


def belief(rng: torch.Generator, *batch: int, log_odds: list[float]) -> ObjectBelief:
    """Two objects with three states and two powers of one tone."""

    def log_weight(*shape: int) -> Tensor:
        return torch.rand(*batch, *shape, generator=rng, dtype=F64).log_softmax(-1)

    return ObjectBelief(
        log_weight(2, 3), log_weight(2, 1, 2), torch.tensor(log_odds, dtype=F64).expand(*batch, 2)
    )


def noise_belief(rng: torch.Generator) -> Noise:
    weight = torch.rand(1, 2, generator=rng, dtype=F64).log_softmax(-1)
    return Noise(torch.ones_like(weight), weight)


def independent(rng: torch.Generator, *shape: int) -> UniformDraws:
    """Draws `(*batch, S)` that are independent of each other."""
    *batch, size = shape

    def uniform(*rows: int) -> Tensor:
        return torch.rand(*batch, *rows, size, generator=rng, dtype=F64)

    return UniformDraws(uniform(2), uniform(2), uniform(2, 1), uniform(1))


def code(drawn: Configurations) -> Tensor:
    """Number of each configuration among 7 * 7 * 2: an object is absent, or in one of 3 * 2 states."""
    alternative = torch.where(drawn.exists, 1 + 2 * drawn.state + drawn.power[..., 0, :], 0)
    return 14 * alternative[..., 0, :] + 2 * alternative[..., 1, :] + drawn.noise[..., 0, :]


def test_frequencies_are_the_proposal_probabilities():
    """Two of three configurations come from the first of two components. All 98 occur, the probabilities add
    up to one, and the counts of 60000 agree with them: chi-squared, false alarm below 1e-5 (with a fixed
    number from each component counts vary less than those of independent draws)."""
    rng = torch.Generator().manual_seed(1)
    runs, components = 20000, [belief(rng, log_odds=[0.3, -0.8]), belief(rng, log_odds=[-1.0, 2.0])]
    noise = noise_belief(rng)
    batched = [ObjectBelief(*(t.expand(runs, *t.shape) for t in c)) for c in components]
    drawn = draw_configurations(
        batched,
        torch.ones(runs, 2, dtype=torch.bool),
        Noise(*(t.expand(runs, -1, -1) for t in noise)),
        independent(rng, runs, 3),
    )
    codes, probability = code(drawn).flatten(), drawn.log_proposal.exp().flatten()
    expected = torch.zeros(98, dtype=F64).index_put((codes,), probability)
    torch.testing.assert_close(expected[codes], probability, rtol=1e-12, atol=0)
    assert expected.gt(0).all()
    assert expected.sum().item() == pytest.approx(1, rel=1e-12)
    count = codes.bincount(minlength=98)
    expected = expected * len(codes)
    assert expected.min() > 5
    assert ((count - expected).square() / expected).sum() < scipy.stats.chi2.isf(1e-5, 97)


def test_probability_of_a_configuration_is_the_product():
    """By hand, for one with both objects, one, and none."""
    rng = torch.Generator().manual_seed(2)
    objects = belief(rng, log_odds=[0.3, -0.8])
    exists = torch.tensor([[True, True, False], [True, False, False]])
    state, power = torch.tensor([[0, 2, 1], [1, 0, 2]]), torch.tensor([[[1, 0, 1]], [[0, 1, 1]]])
    found = log_probability(objects, exists, state, power).exp()
    r, weight, tone = objects.log_odds.sigmoid(), objects.log_weight.exp(), objects.log_power_weight.exp()
    first = r[0] * weight[0, 0] * tone[0, 0, 1] * r[1] * weight[1, 1] * tone[1, 0, 0]
    second = r[0] * weight[0, 2] * tone[0, 0, 0] * (1 - r[1])
    torch.testing.assert_close(found, torch.stack([first, second, (1 - r[0]) * (1 - r[1])]))


@pytest.mark.parametrize("log_odds", [-40.0, 40.0])
def test_neither_existence_nor_absence_is_beyond_doubt(log_odds):
    rng, size = torch.Generator().manual_seed(3), 1000
    draws = independent(rng, size)._replace(
        existence=((torch.arange(size, dtype=F64) + 0.5) / size).expand(2, -1)
    )
    objects, noise = belief(rng, log_odds=[log_odds, 0.0]), noise_belief(rng)
    drawn = draw_configurations([objects], torch.ones(1, dtype=torch.bool), noise, draws)
    rare = drawn.exists[0] if log_odds < 0 else ~drawn.exists[0]
    assert rare.sum() == DOUBT * size
    assert drawn.exists[1].sum() == size / 2
    doubtful = torch.tensor([math.copysign(math.log(1 / DOUBT - 1), log_odds), 0.0], dtype=F64)
    density = log_probability(objects._replace(log_odds=doubtful), drawn.exists, drawn.state, drawn.power)
    torch.testing.assert_close(drawn.log_proposal, density + noise.log_weight[0, drawn.noise[0]])


def test_what_cannot_exist_is_never_drawn():
    rng, size = torch.Generator().manual_seed(4), 1000
    objects, noise = belief(rng, log_odds=[-math.inf, 1.0]), noise_belief(rng)
    draws = independent(rng, size)._replace(existence=torch.zeros(2, size, dtype=F64))
    drawn = draw_configurations([objects], torch.ones(1, dtype=torch.bool), noise, draws)
    assert not drawn.exists[0].any()
    assert drawn.exists[1].all()
    # Its absence is certain, so that the other object and the noise are all there is to the density.
    inside = objects.log_weight[1, drawn.state[1]] + objects.log_power_weight[1, 0, drawn.power[1, 0]]
    expected = (
        torch.nn.functional.logsigmoid(objects.log_odds[1]) + inside + noise.log_weight[0, drawn.noise[0]]
    )
    torch.testing.assert_close(drawn.log_proposal, expected)


def test_inactive_components_get_no_samples():
    """Three components, each certain of another state; which are in use differs across the batch."""
    rng, size = torch.Generator().manual_seed(5), 12
    active = torch.tensor(
        [[True, True, True], [True, False, True], [True, False, False], [True, True, False]]
    )
    components = []
    for c in range(3):
        certain = torch.full((4, 2, 3), -math.inf, dtype=F64)
        certain[..., c] = 0.0
        components.append(belief(rng, 4, log_odds=[3.0, 3.0])._replace(log_weight=certain))
    noise = Noise(*(t.expand(4, -1, -1) for t in noise_belief(rng)))
    draws = independent(rng, 4, size)
    draws = draws._replace(existence=torch.zeros_like(draws.existence))
    drawn = draw_configurations(components, active, noise, draws)
    for b, used in enumerate(active.tolist()):
        count = torch.stack([s.bincount(minlength=3) for s in drawn.state[b]])
        assert count.tolist() == [[size // sum(used) if u else 0 for u in used]] * 2
        # No other component could have drawn the same: the density is its share times its own.
        for s in range(size):
            c = int(drawn.state[b, 0, s])
            own = ObjectBelief(*(t[b] for t in components[c]))
            one = (drawn.exists[b, :, s, None], drawn.state[b, :, s, None], drawn.power[b, :, :, s, None])
            expected = log_probability(own, *one)[0] - math.log(sum(used))
            expected = expected + noise.log_weight[b, 0, drawn.noise[b, 0, s]]
            torch.testing.assert_close(drawn.log_proposal[b, s], expected)


def test_draws_carry_no_gradient():
    rng = torch.Generator().manual_seed(6)
    objects = ObjectBelief(*(t.requires_grad_() for t in belief(rng, log_odds=[0.0, 1.0])))
    noise = Noise(*(t.requires_grad_() for t in noise_belief(rng)))
    drawn = draw_configurations([objects], torch.ones(1, dtype=torch.bool), noise, independent(rng, 5))
    assert not drawn.log_proposal.requires_grad


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_every_row_meets_every_stratum_once(dtype):
    streams = RandomStreams.from_seeds([1, 2], (2,), dtype)
    draws = UniformDraws.draw(streams, 3, 4, 50)
    assert [t.shape for t in draws] == [(2, 3, 50), (2, 3, 50), (2, 3, 4, 50), (2, 4, 50)]
    rows = torch.cat([t.reshape(2, -1, 50) for t in draws], 1)
    assert rows.dtype == dtype
    strata = (rows * 50).floor().long()
    assert torch.equal(strata.sort(-1).values, torch.arange(50).expand_as(strata))
    orders = {tuple(row) for row in strata.flatten(0, 1).tolist()}
    assert len(orders) == strata.shape[0] * strata.shape[1]


def test_draws_are_uniform_and_rows_independent():
    """The same entry of 20000 rows by Kolmogorov and Smirnov, and the correlation of neighbouring rows: false
    alarm of 1e-6 each."""
    draws = UniformDraws.draw(RandomStreams.from_seeds(range(2000), (2000,), F64), 2, 2, 8)
    rows = torch.cat([t.reshape(2000, -1, 8) for t in draws], 1)
    first = rows[..., 0]
    assert scipy.stats.kstest(first.flatten().numpy(), "uniform").pvalue > 1e-6
    product = (first[:, ::2] - 0.5) * (first[:, 1::2] - 0.5) * 12
    assert abs(product.mean().item()) < scipy.stats.norm.isf(5e-7) / product.numel() ** 0.5


@pytest.mark.parametrize(("known", "newborn"), [(4, 3), (1, 2), (2, 0)])
def test_pick_takes_the_first_known_and_the_first_new(known, newborn):
    """Of four slots and three births."""
    draws = UniformDraws.draw(RandomStreams.from_seeds([1, 2], (2,), F64), 7, 2, 5)
    picked = draws.pick(known, 4, newborn)
    kept = [*range(known), *range(4, 4 + newborn)]
    for name in ("existence", "state", "power"):
        assert torch.equal(getattr(picked, name), getattr(draws, name)[:, kept])
    assert torch.equal(picked.noise, draws.noise)


def scene_of_two():
    scene = make_scene(0, (-15.0, 12.0), (8.0, 2.0), SAME)
    given = (scene.prior, scene.response, scene.measurement)
    return scene, given, update(*given[:2], scene.noise, given[2])


def test_without_exchangeable_pairs_the_beliefs_are_all_there_is():
    _, given, beliefs = scene_of_two()
    components, active = labellings(*given, beliefs, torch.zeros(2, 2, dtype=torch.bool))
    assert components == [beliefs.objects]
    assert active.tolist() == [True]


def test_exchanged_objects_take_each_others_place():
    """The upper triangle of pairs is read. Both regions are the same, so that in the exchanged labelling each
    object has the belief of the other, but for what the one it replaces had been tested against."""
    scene, given, beliefs = scene_of_two()
    pairs = torch.tensor([[False, True], [False, False]])
    (first, second), active = labellings(*given, beliefs, pairs)
    assert first is beliefs.objects
    assert active.tolist() == [True, True]
    bearing = scene.prior.state[0, :, 0]
    mean = (first.log_weight.exp() * bearing).sum(-1)
    exchanged = (second.log_weight.exp() * bearing).sum(-1)
    assert (mean[0] - mean[1]).abs() > 20
    torch.testing.assert_close(exchanged, mean.flip(0), rtol=0, atol=0.5)
    assert second.log_odds.min() > 5
    none, active = labellings(*given, beliefs, pairs.T)
    assert len(none) == 1
    assert active.tolist() == [True]


def test_pairs_differ_across_the_batch():
    """Objects 0 and 1 change places in one of two equal scenes; a third object keeps its belief."""
    scene, _, _ = scene_of_two()
    prior = Objects(*(torch.cat([t, t[:1]]) for t in scene.prior))
    response = torch.cat([scene.response, scene.response[:1]])
    beliefs = update(prior, response, scene.noise, scene.measurement)
    pairs = torch.zeros(3, 3, dtype=torch.bool)
    pairs[0, 1] = True
    (_, alone), _ = labellings(prior, response, scene.measurement, beliefs, pairs)
    for before, after in zip(beliefs.objects, alone, strict=True):
        assert torch.equal(after[2], before[2])
        assert not torch.equal(after[:2], before[:2])
    given = (repeat(t, 2) for t in (prior, response, scene.measurement, beliefs))
    components, active = labellings(*given, torch.stack([0 * pairs, pairs]))
    assert active.tolist() == [[True, False], [True, True]]
    assert len(components) == 2
    for found, expected in zip(components[1], alone, strict=True):
        torch.testing.assert_close(found[1], expected)
