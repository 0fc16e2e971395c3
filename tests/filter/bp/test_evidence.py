"""Evidence of one step against exact enumeration, sums by hand."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from oracles.arrays import complex_normal, direct_log_likelihood
from oracles.enumeration import enumerate_pair
from oracles.scenes import LEFT_RIGHT, UNAMBIGUOUS, Scene, make_scene, repeat, unambiguous
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.filter.bp.beliefs import Beliefs, initial_beliefs
from torchdt.filter.bp.configurations import Configurations, UniformDraws, draw_configurations, labellings
from torchdt.filter.bp.evidence import gaussian_evidence, sampled_evidence
from torchdt.filter.bp.update import update
from torchdt.filter.state import Objects
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.base import Noise

F64 = torch.float64


def predicted(scene: Scene) -> Beliefs:
    return initial_beliefs(scene.prior, scene.response, scene.noise)


def draw(beliefs: Beliefs, size: int) -> Configurations:
    """Configurations of one run from the beliefs as they are."""
    draws = UniformDraws.draw(RandomStreams.from_seeds([1], (), F64), 2, 7, size)
    return draw_configurations([beliefs.objects], torch.ones(1, dtype=torch.bool), beliefs.noise, draws)


def sample(scene: Scene, runs: int, size: int, exchange: bool = True) -> Tensor:
    """Independent sampled evidences of a scene, `(runs,)`, with the beliefs of BP as the proposal."""
    beliefs = update(scene.prior, scene.response, scene.noise, scene.measurement)
    pairs = torch.full((2, 2), exchange)
    components, active = labellings(scene.prior, scene.response, scene.measurement, beliefs, pairs)
    components, noise = [repeat(c, runs) for c in components], repeat(beliefs.noise, runs)
    draws = UniformDraws.draw(RandomStreams.from_seeds(range(runs), (runs,), F64), 2, 7, size)
    drawn = draw_configurations(components, repeat(active, runs), noise, draws)
    given = (repeat(t, runs) for t in (scene.prior, scene.response, scene.noise, scene.measurement))
    return sampled_evidence(*given, drawn)


def test_gaussian_without_objects_and_with_known_noise_is_exact():
    scene = make_scene(1, (), (), LEFT_RIGHT, num_noise=1, prior_existence=(1e-300, 1e-300))
    evidence = gaussian_evidence(predicted(scene), scene.measurement)
    assert evidence.item() == pytest.approx(enumerate_pair(scene.problem).log_evidence, rel=1e-12)


def test_gaussian_with_objects_is_that_of_matched_moments():
    scene = make_scene(1, (-20.0,), (4.0,), LEFT_RIGHT)
    covariance = scene.noise.variance.mean(-1)[:, None, None] * torch.eye(8)
    for n in range(2):
        for x in range(120):
            a = scene.response[n, :, x]
            power = 0.1 * scene.prior.power[n].mean(-1) / 120
            covariance = covariance + power[:, None, None] * a[:, :, None] * a[:, None, :].conj()
    expected = direct_log_likelihood(scene.measurement.factor.mT, covariance).sum()
    found = gaussian_evidence(predicted(scene), scene.measurement)
    assert found.item() == pytest.approx(expected.item(), rel=1e-12)
    assert np.isfinite(expected.item())


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("case", UNAMBIGUOUS)
def test_sampled_equals_exact_enumeration(case, seed):
    """Over 100 runs of 64 configurations: bias below 0.1, deviation below 0.3 nats; both are three times what
    is found in the worst scene, and the bias eight of its standard errors. The Gaussian evidence is crude."""
    scene, exact = unambiguous(case, seed)
    error = sample(scene, 100, 64) - exact.log_evidence
    assert error.mean().abs() < 0.1
    assert error.std() < 0.3
    assert gaussian_evidence(predicted(scene), scene.measurement) < exact.log_evidence - 50


@pytest.mark.parametrize("seed", [0, 1])
def test_one_labelling_of_two_misses_half_of_the_evidence(seed):
    """Two objects that may change places, of which BP settles for one arrangement."""
    scene, exact = unambiguous("two in the same region", seed)
    error = sample(scene, 100, 64, exchange=False) - exact.log_evidence
    assert error.mean().item() == pytest.approx(-math.log(2), abs=0.05)


@pytest.mark.parametrize(("seed", "power"), [(5, 0.12), (6, 0.12), (6, 0.09)])
def test_few_samples_are_unbiased(seed, power):
    """Sources at the threshold of detection, exact existence of one 0.02, 0.97 and 0.005. The mean of p over
    2000 runs, relative to the exact one, is one within 4.8 standard errors: false alarm of 2e-6 for each of
    six numbers."""
    scene = make_scene(seed, (-20.0, 25.0), (power, power), LEFT_RIGHT, num_noise=1)
    exact = enumerate_pair(scene.problem).log_evidence
    for size in (2, 3):
        ratio = (sample(scene, 2000, size) - exact).exp()
        assert abs(ratio.mean().item() - 1) < 4.8 * ratio.std().item() / 2000**0.5
        assert ratio.max() < 4  # no rare large ones on which the mean would hang


def sum_by_hand(
    scene: Scene, drawn: Configurations, heard: Tensor, diffuse: Tensor | None, prior_weight: Tensor
) -> float:
    """One configuration after the other, with the covariance of each from its sum."""
    log_ratio = []
    for s in range(drawn.log_proposal.shape[-1]):
        total = -drawn.log_proposal[s]
        for n in range(2):
            exists = drawn.exists[n, s]
            total = total + torch.nn.functional.logsigmoid((2 * exists.long() - 1) * scene.prior.log_odds[n])
            total = total + exists * prior_weight[n, drawn.state[n, s]]
            for i in range(7):
                total = total + exists * scene.prior.log_power_weight[n, i, drawn.power[n, i, s]]
        for i in range(7):
            level = drawn.noise[i, s]
            covariance = scene.noise.variance[i, level] * torch.eye(8, dtype=torch.complex128)
            for n in range(2):
                a = scene.response[n, i, drawn.state[n, s]]
                moment = torch.outer(a, a.conj()) + (0 if diffuse is None else diffuse[n, i])
                power = scene.prior.power[n, i, drawn.power[n, i, s]]
                covariance = covariance + drawn.exists[n, s] * power * moment
            kept = heard[i].nonzero()[:, 0]
            z = scene.measurement.factor[i].mT[:, kept]
            total = (
                total + direct_log_likelihood(z, covariance[kept][:, kept]) + scene.noise.log_weight[i, level]
            )
        log_ratio.append(total)
    return (torch.stack(log_ratio).logsumexp(-1) - math.log(len(log_ratio))).item()


@pytest.mark.parametrize("with_diffuse", [False, True])
@pytest.mark.parametrize("missing", [[], [(slice(None), 0), (2, 5)], [(3, slice(None))]])
def test_equals_the_sum_over_configurations_by_hand(with_diffuse, missing):
    """Weights of the states are not normalised, some existence is absence, and some sensors are missing: one
    throughout and another in one tone, or a whole tone."""
    scene = make_scene(3, (-20.0, 25.0), (0.1, 0.2), LEFT_RIGHT)
    rng = torch.Generator().manual_seed(2)
    root = complex_normal(rng, 2, 7, 8, 8) / 8
    diffuse = root @ root.mH if with_diffuse else None
    snapshots = scene.measurement.factor.mT.clone()
    heard = torch.ones(7, 8, dtype=torch.bool)
    for tone, sensor in missing:
        snapshots[tone, :, sensor] = torch.nan
        heard[tone, sensor] = False
    measurement = from_snapshots(snapshots)
    prior_weight = scene.prior.log_weight + torch.randn(2, 120, generator=rng, dtype=F64)
    prior = scene.prior._replace(log_weight=prior_weight)
    beliefs = initial_beliefs(scene.prior, scene.response, scene.noise)
    beliefs = beliefs._replace(
        objects=beliefs.objects._replace(log_odds=torch.tensor([0.5, -0.5], dtype=F64))
    )
    drawn = draw(beliefs, 16)
    assert len({tuple(e) for e in drawn.exists.T.tolist()}) == 4
    found = sampled_evidence(prior, scene.response, scene.noise, measurement, drawn, diffuse)
    expected = sum_by_hand(scene, drawn, heard, diffuse, prior_weight)
    assert found.item() == pytest.approx(expected, rel=1e-10)


def test_gradients_of_everything_but_the_configurations():
    rng = torch.Generator().manual_seed(8)
    objects, tones, states, powers, levels, sensors, size = 2, 2, 4, 3, 2, 3, 6

    def index(limit: int, *shape: int) -> Tensor:
        return torch.randint(limit, (*shape, size), generator=rng)

    def real(*shape: int) -> Tensor:
        return torch.randn(shape, generator=rng, dtype=F64)

    exists = torch.tensor([[1, 1, 1, 1, 0, 0], [1, 0, 1, 0, 1, 0]]).bool()
    drawn = Configurations(
        exists, index(states, objects), index(powers, objects, tones), index(levels, tones), real(size)
    )
    measurement = from_snapshots(complex_normal(rng, tones, 2, sensors))
    inputs = (
        real(objects, states),
        real(objects, tones, powers).exp(),
        real(objects, tones, powers),
        real(objects),
        real(tones, levels).exp(),
        real(tones, levels),
        complex_normal(rng, objects, tones, states, sensors),
        complex_normal(rng, objects, tones, sensors, sensors),
    )

    def evidence(weight, power, power_weight, odds, variance, noise_weight, response, root):
        state, label = torch.zeros(objects, states, 2, dtype=F64), torch.zeros(objects, dtype=torch.int64)
        prior = Objects(state, weight, power, power_weight, odds, label, torch.ones_like(weight))
        noise = Noise(variance, noise_weight)
        return sampled_evidence(prior, response, noise, measurement, drawn, root @ root.mH)

    assert torch.autograd.gradcheck(evidence, tuple(t.requires_grad_() for t in inputs))
    gradients = torch.autograd.grad(evidence(*inputs), inputs)
    assert all(g.abs().max() > 0.01 for g in gradients)


def test_single_precision_keeps_its_type():
    scene = make_scene(1, (-20.0,), (4.0,), LEFT_RIGHT)
    beliefs = update(scene.prior, scene.response, scene.noise, scene.measurement)
    drawn = draw(beliefs, 64)

    def single(tree: Any) -> Any:
        return type(tree)(*(t.to(types.get(t.dtype, t.dtype)) for t in tree))

    types = {F64: torch.float32, torch.complex128: torch.complex64}
    given = (scene.prior, scene.response, scene.noise, scene.measurement)
    prior, noise, measurement = (single(given[n]) for n in (0, 2, 3))
    found = sampled_evidence(prior, scene.response.to(torch.complex64), noise, measurement, drawn)
    assert found.dtype == torch.float32
    assert found.item() == pytest.approx(sampled_evidence(*given, drawn).item(), rel=1e-5)
