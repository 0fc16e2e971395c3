"""The end of a step on beliefs written by hand: two sequences, three slots, one new object."""

import math

import pytest
import torch
from oracles.line_array import make_region
from torch import Tensor

from torchdt.filter.bp.beliefs import Beliefs, as_belief
from torchdt.filter.config import TrackerConfig
from torchdt.filter.declare import empty_slots, idle_particles, posterior, report
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
        torch.ones(*batch, PARTICLES, dtype=F64),
    )


OLD = TrackerState(
    make_objects([[0.9, 0.8, 0.0], [0.9, 0.0, 0.0]], [[3, 4, 0], [1, 0, 0]], [1.0, 1.0, 1.0], seed=9),
    Noise(torch.ones(2, TONES, 3, dtype=F64), torch.full((2, TONES, 3), -math.log(3), dtype=F64)),
    torch.tensor([5, 2]),
    torch.zeros(2, 0, dtype=F64),
    torch.zeros(2, 0, dtype=F64),
)


def end(existence: list[list[float]], label: list[list[int]], power: list[float]):
    """Prior objects with the weights of others, the posterior beliefs, and what becomes of them."""
    prior = make_objects([[0.5] * len(power)] * 2, label, power)
    updated = make_objects(existence, label, power, seed=2)
    rng = torch.Generator().manual_seed(3)
    noise = Noise(
        torch.rand(2, TONES, 3, generator=rng, dtype=F64),
        torch.rand(2, TONES, 3, generator=rng, dtype=F64).log_softmax(-1),
    )
    unused = torch.zeros(())
    beliefs = Beliefs(as_belief(updated), noise, unused, unused, unused)
    return (
        prior,
        beliefs,
        report(
            posterior(prior, beliefs),
            beliefs.noise,
            OLD,
            torch.tensor([-7.0, 8.0], dtype=F64),
            REGION,
            CONFIG,
        ),
    )


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
