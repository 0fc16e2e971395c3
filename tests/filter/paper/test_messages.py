"""Messages of the paper's graph against enumeration where they are exact, against plain sums elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from oracles.paper_graph import Graph, Marginals, enumerate_one, flood, known_object, random_graph

from torchdt.core.linalg import NumericalError
from torchdt.filter.paper.messages import pass_messages, snapshots
from torchdt.filter.state import Objects
from torchdt.model.measurement import from_covariance, from_snapshots
from torchdt.model.noise.base import Noise
from torchdt.model.noise.white import WhiteNoise

seeds = pytest.mark.parametrize("seed", range(3))


def believe(g: Graph, iterations: int) -> Marginals:
    with np.errstate(divide="ignore"):
        objects = Objects(
            state=torch.zeros(*g.state.shape, 2, dtype=torch.float64),
            log_weight=torch.tensor(np.log(g.state)),
            power=torch.tensor(g.power),
            log_power_weight=torch.tensor(np.log(g.psi)),
            log_odds=torch.tensor(np.log(g.existence) - np.log1p(-g.existence)),
            label=torch.zeros(len(g.state), dtype=torch.int64),
            transmits=torch.ones(g.state.shape, dtype=torch.float64),
        )
    noise = Noise(torch.tensor(g.variance), torch.tensor(np.log(g.xi)))
    measurement = from_snapshots(torch.tensor(g.data).transpose(0, 1))
    found, level = pass_messages(
        objects, torch.tensor(g.response), noise, measurement, WhiteNoise(), iterations
    )
    assert torch.equal(found.power, objects.power)
    weights = found.log_weight, found.log_power_weight, level.log_weight
    state, power, noise_weight = (t.exp().numpy() for t in weights)
    return Marginals(state, power, found.existence.numpy(), noise_weight)


def close(found: Marginals, expected: Marginals, *names: str) -> None:
    for name in names:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-13)


@seeds
@pytest.mark.parametrize("iterations", [1, 4])
def test_one_object_in_one_snapshot_is_exact(seed, iterations):
    """A tree; with the noise known nothing is moment-matched."""
    g = random_graph(seed, 1, 1, 1, states=5, powers=4, noises=1)
    close(believe(g, iterations), enumerate_one(g), "state", "power", "existence")


@seeds
def test_unknown_noise_beside_a_known_object_is_exact(seed):
    g = known_object(random_graph(seed, 1, 1, 1, states=3, powers=3, noises=6), 0)
    close(believe(g, 1), enumerate_one(g), "noise")


@seeds
def test_a_known_object_is_background_to_another(seed):
    """Whitening the data by the known object leaves a single object in white noise of known variance."""
    g = random_graph(seed, 2, 1, 1, states=4, powers=3, noises=1)
    g = known_object(g, 1)
    a, gamma, eta = g.response[1, 0, 0], g.power[1, 0, 0], g.variance[0, 0]
    whitening = np.linalg.inv(np.linalg.cholesky(gamma * np.outer(a, a.conj()) / eta + np.eye(len(a))))
    alone = replace(
        g,
        response=g.response[:1] @ whitening.T,
        state=g.state[:1],
        power=g.power[:1],
        psi=g.psi[:1],
        existence=g.existence[:1],
        data=g.data @ whitening.T,
    )
    found, exact = believe(g, 1), enumerate_one(alone)
    np.testing.assert_allclose(found.state[:1], exact.state, rtol=1e-9)
    np.testing.assert_allclose(found.power[:1], exact.power, rtol=1e-9)
    np.testing.assert_allclose(found.existence[0], exact.existence[0], rtol=1e-9)


@seeds
def test_matched_noise_is_within_its_bound(seed):
    """A tree too, but the noise reaches the object as its mean.

    For any signal covariance, `d log CN(z; 0, C + eta I) / d eta = -tr K + z^H K^2 z`, `K = (C + eta I)^-1`,
    is between `-M / eta` and `|z|^2 / eta^2`. So `log CN` at a noise variance differs from that at their mean
    by at most `B = max(M |log ratio|, |z|^2 |1 / eta - 1 / mean|)`; averages of densities by no more; and
    normalised weights and odds, ratios of two such averages, by at most 2 B in their logarithms.
    """
    g = random_graph(seed, 1, 1, 1, states=5, powers=4, noises=3)
    g = replace(g, variance=0.6 * np.array([[0.98, 1.0, 1.03]]))
    mean, energy = g.xi[0] @ g.variance[0], np.square(np.abs(g.data)).sum()
    steps = 4 * np.abs(np.log(g.variance / mean)), energy * np.abs(1 / g.variance - 1 / mean)
    bound = 2 * np.maximum(*steps).max()
    found, exact = believe(g, 1), enumerate_one(g)
    odds, exact_odds = (m.existence / (1 - m.existence) for m in (found, exact))
    ratios = found.state / exact.state, found.power / exact.power, odds / exact_odds
    largest = max(np.abs(np.log(ratio)).max() for ratio in ratios)
    assert 1e-6 < largest < bound < 1


@seeds
@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_all_messages_are_those_of_plain_sums(seed, iterations):
    """Two objects, two tones, two snapshots: loops, and every message without what its receiver said."""
    g = random_graph(seed, 2, 2, 2, states=3, powers=2, noises=3)
    close(believe(g, iterations), flood(g, iterations), "state", "power", "existence", "noise")


def test_an_empty_slot_says_nothing():
    g = random_graph(0, 2, 2, 2, states=3, powers=2, noises=3)
    g = replace(g, existence=np.array([g.existence[0], 0.0]))
    alone = replace(
        g, **{name: getattr(g, name)[:1] for name in ("response", "state", "power", "psi", "existence")}
    )
    found, expected = believe(g, 3), believe(alone, 3)
    assert found.existence[1] == 0
    np.testing.assert_allclose(found.existence[:1], expected.existence, rtol=1e-9)
    np.testing.assert_allclose(found.noise, expected.noise, rtol=1e-9)


def test_single_snapshots_make_up_the_scatter_matrix():
    """Also where only that is known, and where a snapshot or a sensor is missing."""
    generator = torch.Generator().manual_seed(0)
    z = torch.randn(2, 5, 4, generator=generator, dtype=torch.complex128)
    z[0, 1], z[1, :, 2] = torch.nan, torch.nan
    kept = torch.nan_to_num(z)
    covariance = kept.mT @ kept.conj() / 5
    for measurement in (from_snapshots(z[:, :3]), from_snapshots(z), from_covariance(covariance, 5)):
        each = snapshots(measurement)
        torch.testing.assert_close(each.num_snapshots.sum(-2), measurement.num_snapshots)
        whole = measurement.factor @ measurement.factor.mH
        torch.testing.assert_close((each.factor @ each.factor.mH).sum(-4), whole)
        assert each.factor.shape[-1] == 1
    assert snapshots(from_snapshots(z[:, :3])).num_snapshots.tolist() == [[1, 1], [0, 1], [1, 1]]


def test_a_message_that_breaks_down_is_named():
    g = random_graph(0, 1, 1, 1, states=3, powers=2, noises=1)
    with pytest.raises(NumericalError, match="kappa"):
        believe(replace(g, data=1e200 * g.data), 1)
