"""Passes over objects, noise and what is no object, and what an explanation is worth."""

import itertools
import math

import pytest
import torch
from oracles.interferers import any_level
from oracles.scenes import LEFT_RIGHT, Scene, make_scene

from torchdt.filter.bp.beliefs import Beliefs, as_belief
from torchdt.filter.bp.messages import ObjectBelief
from torchdt.filter.bp.update import divergence, free_energy, update
from torchdt.filter.interference.settings import FreeSignatures
from torchdt.filter.interference.signatures import Interferers, fit
from torchdt.filter.state import Objects
from torchdt.model.measurement import gaussian_log_likelihood
from torchdt.model.noise.white import WHITE

F64 = torch.float64


def test_a_broken_measurement_is_named():
    scene = make_scene(0, (-20.0,), (4.0,), LEFT_RIGHT)
    broken = scene.measurement._replace(factor=scene.measurement.factor * torch.inf)
    with pytest.raises(ArithmeticError, match="message to the object state"):
        update(scene.prior, scene.response, scene.noise, broken)


def test_belief_without_data_is_the_prior():
    scene = make_scene(0, (-20.0,), (4.0,), LEFT_RIGHT)
    silent = scene.measurement._replace(
        factor=torch.zeros_like(scene.measurement.factor),
        num_snapshots=torch.zeros_like(scene.measurement.num_snapshots),
    )
    found = update(scene.prior, scene.response, scene.noise, silent).objects
    for belief, prior in zip(found, as_belief(scene.prior), strict=True):
        torch.testing.assert_close(belief, prior)


def test_empty_slots_stay_empty_and_do_not_matter():
    scene = make_scene(1, (-20.0, 25.0), (4.0, 4.0), LEFT_RIGHT)
    empty = scene.prior._replace(log_odds=torch.full((2,), -torch.inf, dtype=torch.float64))
    prior = Objects(*(torch.cat([e[:1], p]) for e, p in zip(empty, scene.prior, strict=True)))
    response = torch.cat([scene.response[1:], scene.response])
    with_empty = update(prior, response, scene.noise, scene.measurement)
    alone = update(scene.prior, scene.response, scene.noise, scene.measurement)
    assert with_empty.objects.log_odds[0] == -torch.inf
    assert with_empty.strength[0].eq(0).all()
    torch.testing.assert_close(with_empty.objects.log_odds[1:], alone.objects.log_odds)
    torch.testing.assert_close(with_empty.objects.log_weight[1:], alone.objects.log_weight)


def worth(beliefs: Beliefs, scene: Scene) -> torch.Tensor:
    return free_energy(beliefs, scene.prior, scene.measurement, WHITE)


def random_belief(seed: int) -> ObjectBelief:
    """Two objects of three states and, in two tones, of two powers."""
    rng = torch.Generator().manual_seed(seed)
    states, powers, odds = (torch.randn(s, dtype=F64, generator=rng) for s in ((2, 3), (2, 2, 2), (2,)))
    return ObjectBelief(states.log_softmax(-1), powers.log_softmax(-1), odds)


def probabilities(belief: ObjectBelief, n: int) -> list[float]:
    """Of all that an object may be: nothing, or there with a state and a power in each tone."""
    r = torch.sigmoid(belief.log_odds[n]).item()
    state, (first, second) = belief.log_weight[n].exp().tolist(), belief.log_power_weight[n].exp().tolist()
    return [1 - r, *(r * math.prod(each) for each in itertools.product(state, first, second))]


def test_the_divergence_is_that_of_all_that_may_be():
    after, before = random_belief(1), random_belief(2)
    expected = sum(
        p * math.log(p / q)
        for n in range(2)
        for p, q in zip(probabilities(after, n), probabilities(before, n), strict=True)
    )
    assert divergence(after, before).item() == pytest.approx(expected)
    assert divergence(before, before).item() == pytest.approx(0.0, abs=1e-12)


def test_slots_and_particles_without_weight_add_nothing():
    after, before = random_belief(1), random_belief(2)
    impossible = torch.tensor([0.0, -torch.inf], dtype=F64)
    first = ObjectBelief(*(t[:1] for t in after)), ObjectBelief(*(t[:1] for t in before))
    expected = divergence(*(b._replace(log_odds=impossible[:1]) for b in first))
    found = divergence(*(b._replace(log_odds=impossible) for b in (after, before)))
    torch.testing.assert_close(found, expected)
    certain = torch.tensor([[0.0, -torch.inf, -torch.inf]] * 2, dtype=F64)
    assert divergence(after._replace(log_weight=certain), before).isfinite()


def test_interferers_count_with_their_covariance_and_their_cost():
    scene = make_scene(1, (-20.0,), (4.0,), LEFT_RIGHT)
    beliefs = update(scene.prior, scene.response, scene.noise, scene.measurement)
    covariance = WHITE.covariance(beliefs.signal, beliefs.noise.mean, scene.measurement.present)
    kl = divergence(beliefs.objects, as_belief(scene.prior))
    alone = gaussian_log_likelihood(scene.measurement, covariance).sum() - kl
    torch.testing.assert_close(worth(beliefs, scene), alone)
    tones, sensors = scene.measurement.present.shape
    before = torch.zeros(tones, sensors, 2, dtype=torch.complex128)
    cost = torch.full((tones,), 0.1, dtype=F64)
    heard, net = fit(scene.measurement, covariance, before, cost, 2.0, True)
    assert heard.any
    found = worth(beliefs._replace(interferers=heard), scene)
    torch.testing.assert_close(found, alone + net.sum())


def test_the_right_explanation_is_worth_more():
    """Two sources that are there, and the same without one of them."""
    scene = make_scene(1, (-20.0, 25.0), (4.0, 4.0), LEFT_RIGHT)
    found = update(scene.prior, scene.response, scene.noise, scene.measurement)
    gone = scene.prior._replace(log_odds=torch.tensor([0.0, -1e5], dtype=F64))
    fewer = update(gone, scene.response, scene.noise, scene.measurement)
    assert torch.sigmoid(fewer.objects.log_odds[1]) == 0
    assert worth(found, scene) > free_energy(fewer, gone, scene.measurement, WHITE) + 10


def test_what_is_no_object_is_found_beside_one():
    scene = make_scene(1, (-20.0,), (4.0,), LEFT_RIGHT)
    rng = torch.Generator().manual_seed(1)
    factor = scene.measurement.factor
    signature = 20 * torch.randn(*factor.shape[:-1], 1, dtype=torch.complex128, generator=rng)
    sound = torch.randn(*factor.shape[:-2], 1, factor.shape[-1], dtype=torch.complex128, generator=rng)
    loud = scene.measurement._replace(factor=factor + signature * sound)
    before = torch.zeros(*factor.shape[:-1], 2, dtype=torch.complex128)
    beliefs = update(
        scene.prior,
        scene.response,
        any_level(factor.shape[0]),
        loud,
        interference=FreeSignatures(signatures=2),
        before=before,
    )
    assert isinstance(beliefs.interferers, Interferers)
    assert beliefs.interferers.columns.ne(0).any(-2).sum(-1).eq(1).all()
    existence = torch.sigmoid(beliefs.objects.log_odds)
    assert existence[0] > 0.9
    assert existence[1] < 0.1
