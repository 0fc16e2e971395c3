"""The end of a step on beliefs written by hand: two sequences, three slots, one new object."""

import math

import pytest
import torch
from oracles.line_array import make_region
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.core.weights import effective_sample_size, mean_and_covariance
from torchdt.filter.bp.schedule import Beliefs, as_belief
from torchdt.filter.config import TrackerConfig
from torchdt.filter.declare import conclude, empty_slots, idle_particles, resample
from torchdt.filter.state import Objects, TrackerState
from torchdt.model.noise.base import Noise

F64 = torch.float64
PARTICLES, TONES, POINTS = 6, 2, 4
REGION = make_region()
CONFIG = TrackerConfig(slots=3, particles=PARTICLES, declare=0.5, prune=0.01)


def make_objects(
    existence: list[list[float]], label: list[list[int]], power: list[float], seed: int = 1
) -> Objects:
    """Objects of a batch of sequences; the power of each slot is the same in all of them."""
    rng = torch.Generator().manual_seed(seed)
    batch = torch.tensor(existence).shape

    def real(*shape: int) -> Tensor:
        return torch.randn(*batch, *shape, generator=rng, dtype=F64)

    points = torch.tensor(power, dtype=F64)[:, None, None] * torch.linspace(0.9, 1.1, POINTS, dtype=F64)
    return Objects(
        real(PARTICLES, 2),
        real(PARTICLES).log_softmax(-1),
        points.expand(*batch, TONES, -1),
        real(TONES, POINTS).log_softmax(-1),
        torch.logit(torch.tensor(existence, dtype=F64)),
        torch.tensor(label),
    )


OLD = TrackerState(
    make_objects([[0.9, 0.8, 0.0], [0.9, 0.0, 0.0]], [[3, 4, 0], [1, 0, 0]], [1.0, 1.0, 1.0], seed=9),
    Noise(torch.ones(2, TONES, 3, dtype=F64), torch.full((2, TONES, 3), -math.log(3), dtype=F64)),
    torch.tensor([5, 2]),
)


def end(existence: list[list[float]], label: list[list[int]], power: list[float]):
    """Prior objects with the weights of others, the posterior beliefs, and what becomes of them."""
    prior = make_objects([[0.5] * len(power)] * 2, label, power)
    posterior = make_objects(existence, label, power, seed=2)
    rng = torch.Generator().manual_seed(3)
    noise = Noise(
        torch.rand(2, TONES, 3, generator=rng, dtype=F64),
        torch.rand(2, TONES, 3, generator=rng, dtype=F64).log_softmax(-1),
    )
    unused = torch.zeros(())
    beliefs = Beliefs(as_belief(posterior), noise, unused, unused, unused)
    return prior, beliefs, conclude(prior, beliefs, OLD, torch.tensor([-7.0, 8.0], dtype=F64), REGION, CONFIG)


def test_improbable_objects_are_dropped_and_the_others_sorted():
    """By existence times power; what is left of the slots is empty and has no label."""
    _, _, (objects, _, estimate) = end(
        [[0.9, 0.009, 0.3, 0.0], [0.02, 0.6, 0.001, 0.005]],
        [[3, 4, 0, 0], [1, 0, 0, 0]],
        [1.0, 2.0, 4.0, 8.0],
    )
    expected = torch.tensor([[0.3, 0.9, 0.0], [0.6, 0.02, 0.0]], dtype=F64)
    torch.testing.assert_close(objects.existence, expected)
    assert torch.equal(estimate.existence, objects.existence)
    assert objects.log_odds[:, 2].isneginf().all()
    assert estimate.declared.tolist() == [[False, True, False], [True, False, False]]


def test_labels_are_given_once_and_kept():
    """Known objects keep theirs also below the threshold; new ones get the next, the strongest first."""
    _, _, (objects, next_label, estimate) = end(
        [[0.9, 0.3, 0.8], [0.2, 0.9, 0.1]], [[3, 4, 0], [1, 0, 0]], [1.0, 2.0, 4.0]
    )
    assert objects.label.tolist() == [[5, 3, 4], [2, 0, 1]]
    assert torch.equal(estimate.label, objects.label)
    assert next_label.tolist() == [6, 3]
    _, _, (objects, next_label, _) = end(
        [[0.9, 0.7, 0.8], [0.9, 0.3, 0.1]], [[0, 0, 0], [1, 0, 0]], [1.0, 2.0, 4.0]
    )
    assert objects.label.tolist() == [[5, 6, 7], [1, 0, 0]]  # 0.8 * 4, 0.7 * 2, 0.9 * 1
    assert next_label.tolist() == [8, 2]


def test_a_dropped_object_leaves_no_label():
    _, _, (objects, next_label, _) = end(
        [[0.001, 0.9, 0.0], [0.001, 0.002, 0.003]], [[3, 4, 0], [1, 0, 0]], [1.0, 2.0, 4.0]
    )
    assert objects.label.tolist() == [[4, 0, 0], [0, 0, 0]]
    assert next_label.tolist() == OLD.next_label.tolist()


def test_estimates_are_moments_of_the_posterior():
    """Slots 1 and 0 by strength, each with the particles of the step and the weights after the data."""
    prior, beliefs, (objects, _, estimate) = end(
        [[0.9, 0.9, 0.0], [0.8, 0.7, 0.0]], [[3, 4, 0], [1, 0, 0]], [1.0, 2.0, 4.0]
    )
    for b in range(2):
        for slot, source in ((0, 1), (1, 0)):
            weight = beliefs.objects.log_weight[b, source].exp()
            assert torch.equal(objects.state[b, slot], prior.state[b, source])
            assert torch.equal(objects.log_weight[b, slot], beliefs.objects.log_weight[b, source])
            torch.testing.assert_close(estimate.state[b, slot], weight @ prior.state[b, source])
            covariance = torch.cov(prior.state[b, source].T, correction=0, aweights=weight)
            torch.testing.assert_close(estimate.state_std[b, slot], covariance.diagonal().sqrt())
            torch.testing.assert_close(estimate.effective_sample_size[b, slot], 1 / weight.square().sum())
            tone = beliefs.objects.log_power_weight[b, source].exp()
            torch.testing.assert_close(estimate.power[b, slot], (tone * prior.power[b, source]).sum(-1))
    noise = (beliefs.noise.log_weight.exp() * beliefs.noise.variance).sum(-1)
    torch.testing.assert_close(estimate.noise, noise)
    assert estimate.log_evidence.tolist() == [-7.0, 8.0]


def two_sets() -> Objects:
    """Two sequences of three objects; the first of each has nearly all its weight on particle 4."""
    objects = make_objects([[0.9, 0.8, 0.7]] * 2, [[1, 2, 3]] * 2, [1.0, 1.0, 1.0])
    logits = torch.linspace(0, 0.5, PARTICLES, dtype=F64).repeat(2, 3, 1)
    logits[:, 0, 4] += 9.0
    return objects._replace(log_weight=logits.log_softmax(-1))


def streams() -> RandomStreams:
    return RandomStreams.from_seeds([1, 2], (2,), F64)


def test_only_sets_of_few_effective_particles_are_resampled():
    config = TrackerConfig(slots=3, particles=PARTICLES, resample_below=0.5, roughening=0.0)
    objects = two_sets()
    found = resample(objects, config, streams())
    assert torch.equal(found.state[:, 1:], objects.state[:, 1:])
    assert torch.equal(found.log_weight[:, 1:], objects.log_weight[:, 1:])
    for b in range(2):
        torch.testing.assert_close(found.state[b, 0], objects.state[b, 0, 4].expand(PARTICLES, 2))
    torch.testing.assert_close(
        found.log_weight[:, 0], torch.full((2, PARTICLES), -math.log(PARTICLES), dtype=F64)
    )
    for name in ("power", "log_power_weight", "log_odds", "label"):
        assert getattr(found, name) is getattr(objects, name)


def test_the_share_of_effective_particles_decides():
    objects = two_sets()
    share = effective_sample_size(objects.log_weight)[0, 1].item() / PARTICLES
    for below, resampled in ((share - 1e-6, False), (share + 1e-6, True)):
        config = TrackerConfig(slots=3, particles=PARTICLES, resample_below=below, roughening=0.0)
        found = resample(objects, config, streams())
        assert (found.log_weight[0, 1] != objects.log_weight[0, 1]).any() == resampled


def test_resampled_particles_are_jittered():
    config = TrackerConfig(slots=3, particles=PARTICLES, resample_below=1.0, roughening=0.1)
    objects = two_sets()
    found = resample(objects, config, streams())
    assert len(found.state[0, 1].unique(dim=0)) == PARTICLES
    distance = (found.state[0, 1][:, None] - objects.state[0, 1]).norm(dim=-1)
    _, covariance = mean_and_covariance(objects.state[0, 1], objects.log_weight[0, 1])
    assert (distance.amin(-1) > 0).all()
    assert (distance.amin(-1) < covariance.diagonal().sum().sqrt()).all()


def test_as_many_numbers_are_drawn_whatever_is_resampled():
    ends = []
    for below in (0.0, 1.0):
        used = streams()
        resample(two_sets(), TrackerConfig(slots=3, particles=PARTICLES, resample_below=below), used)
        ends.append(used.normal(3))
    assert torch.equal(*ends)


def test_resampled_weights_keep_the_gradient_of_their_ancestors():
    """Without jitter the particles tell whose copies they are."""
    config = TrackerConfig(slots=3, particles=PARTICLES, resample_below=1.0, roughening=0.0)
    objects = two_sets()
    log_weight = objects.log_weight.clone().requires_grad_()
    found = resample(objects._replace(log_weight=log_weight), config, streams())
    copies = (found.state[..., None, :] - objects.state[..., None, :, :]).norm(dim=-1) < 1e-9
    assert copies.sum(-1).eq(1).all()
    (slope,) = torch.autograd.grad(found.log_weight.sum(), log_weight)
    assert torch.equal(slope, copies.sum(-2).double())


def test_empty_slots_get_idle_particles_of_even_weight():
    idle = idle_particles(make_region(), PARTICLES)
    objects = OLD.objects
    found = empty_slots(objects, idle)
    empty = objects.log_odds.isneginf()
    assert empty.tolist() == [[False, False, True], [False, True, True]]
    assert torch.equal(found.state[~empty], objects.state[~empty])
    assert torch.equal(found.log_weight[~empty], objects.log_weight[~empty])
    assert found.state[empty].eq(idle).all()
    torch.testing.assert_close(
        found.log_weight[empty].exp(), torch.full((3, PARTICLES), 1 / PARTICLES, dtype=F64)
    )
    assert found.log_odds is objects.log_odds


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_idle_particles_span_the_region(dtype):
    region = make_region(dtype)
    idle = idle_particles(region, 50)
    assert idle.dtype == dtype
    assert idle.shape == (50, 2)
    assert region.contains(idle).all()
    assert idle[[0, -1]].tolist() == [[-70.0, 0.0], [70.0, 0.0]]
