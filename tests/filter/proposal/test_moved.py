"""Redrawing the particles of known objects: one object with a Gaussian prediction on a line array."""

import math

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.line_array import make_field, make_region

from torchdt.core.mixture import GaussianMixture, cluster_moments
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import scale_tril
from torchdt.core.weights import mean_and_covariance
from torchdt.filter.bp.beliefs import initial_beliefs
from torchdt.filter.bp.messages import state_message
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.proposal.moved import Draws, propose_adapted, respond
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.noise.base import Noise

F64 = torch.float64
FIELD, REGION, ETA, PARTICLES = make_field(), make_region(), 0.0125, 1000


def measure(seed: int, bearing: float, power: float) -> Measurement:
    rng = torch.Generator().manual_seed(seed)
    a = FIELD(torch.tensor([bearing], dtype=F64))
    z = ETA**0.5 * complex_normal(rng, 2, 4, 8) + power**0.5 * complex_normal(rng, 2, 4, 1) * a[:, None]
    return from_snapshots(z)


def predict(mean: float, deviation: float, runs: int, log_odds: float = -2.0) -> tuple[Objects, Noise]:
    """The same prediction for every run of a batch, of exactly these moments."""
    rng = torch.Generator().manual_seed(9)
    raw = torch.randn(PARTICLES, 2, generator=rng, dtype=F64)
    raw = raw - raw.mean(0)
    raw = raw @ torch.linalg.inv(torch.linalg.cholesky(raw.T @ raw / PARTICLES)).T
    # Rate 0.1 deg/s wide and correlated with the bearing.
    tril = torch.tensor([[deviation, 0.0], [0.06, 0.08]], dtype=F64)
    state = torch.tensor([mean, 0.2], dtype=F64) + raw @ tril.T
    power = torch.logspace(-1, 1, 5, dtype=F64)
    objects = Objects(
        state=state.expand(runs, 1, -1, -1),
        log_weight=torch.full((runs, 1, PARTICLES), -math.log(PARTICLES), dtype=F64),
        power=power.expand(runs, 1, 2, -1),
        log_power_weight=torch.full((runs, 1, 2, 5), -math.log(5), dtype=F64),
        log_odds=torch.full((runs, 1), log_odds, dtype=F64),
        label=torch.ones(runs, 1, dtype=torch.int64),
        transmits=torch.ones(runs, 1, PARTICLES, dtype=F64),
    )
    return objects, Noise(torch.full((runs, 2, 1), ETA, dtype=F64), torch.zeros(runs, 2, 1, dtype=F64))


def propose(objects: Objects, noise: Noise, measurement: Measurement):
    runs = objects.log_odds.shape[0]
    batched = Measurement(*(t.expand(runs, *t.shape) for t in measurement))
    beliefs = initial_beliefs(objects, respond(FIELD, objects.state), noise)
    streams = RandomStreams.from_seeds(range(runs), (runs,), F64)
    draws = Draws(streams.normal(1, 4, 128, 1), streams.normal(1, PARTICLES, 2))
    share, mean, covariance = cluster_moments(objects.state, objects.log_weight, 4)
    density = GaussianMixture(share, mean, scale_tril(covariance))
    return propose_adapted(FIELD, REGION, objects, density, beliefs, batched, draws)


def quadrature(measurement: Measurement, mean: float, deviation: float):
    """Log evidence ratio of the object, and mean and deviation of its bearing, on a fine grid.

    Given that it is in the region: the probability that it left is not part of its state.
    """
    grid = torch.linspace(max(-70, mean - 8 * deviation), min(70, mean + 8 * deviation), 8001, dtype=F64)
    normal = torch.distributions.Normal(mean, deviation)
    inside = normal.cdf(torch.tensor([-70.0, 70.0], dtype=F64)).diff()
    prior = normal.log_prob(grid) - inside.log()
    background = ETA * torch.eye(8, dtype=torch.complex128).expand(2, -1, -1)
    power = torch.logspace(-1, 1, 5, dtype=F64).expand(2, -1)
    message = state_message(
        whiten(measurement, background),
        respond(FIELD, grid[:, None]),
        power,
        torch.full_like(power, -math.log(5)),
    )
    joint = prior + message
    weight = joint.softmax(-1)
    centre = (weight * grid).sum()
    spread = (weight * (grid - centre).square()).sum().sqrt()
    return joint.logsumexp(-1) + (grid[1] - grid[0]).log(), centre, spread


@pytest.mark.parametrize(
    ("mean", "deviation", "bearing", "power"),
    [
        (10.0, 0.5, 10.4, 1.0),  # tracking
        (10.0, 6.0, 16.0, 10.0),  # a sharp likelihood in a wide prediction
        (10.0, 0.05, 10.1, 0.1),  # the prediction knows more than the data
        (69.0, 1.5, 68.6, 1.0),  # partly outside of the region
        (10.0, 0.5, 10.4, 0.0),  # nothing there
    ],
)
def test_existence_and_bearing_agree_with_quadrature(mean, deviation, bearing, power):
    """Over 10 runs: every evidence within 20 %, the mean within 4 %; the bearing within a tenth of its
    deviation on average."""
    runs, measurement = 10, measure(4, bearing, power)
    objects, noise = predict(mean, deviation, runs)
    moved, response, beliefs = propose(objects, noise, measurement)
    log_evidence, centre, spread = quadrature(measurement, mean, deviation)
    ratio = (beliefs.objects.log_odds[:, 0] + 2.0 - log_evidence).exp()
    assert (ratio - 1).abs().max() < 0.2
    assert ratio.mean().item() == pytest.approx(1, abs=0.04)
    found, covariance = mean_and_covariance(moved.state[:, 0], beliefs.objects.log_weight[:, 0])
    assert (found[:, 0].mean() - centre).abs() < 0.1 * spread
    torch.testing.assert_close(covariance[:, 0, 0].sqrt().mean(), spread, rtol=0.1, atol=0)
    torch.testing.assert_close(response, respond(FIELD, moved.state))


def test_rates_follow_the_bearing():
    """The predicted rate given the bearing is 0.2 + 0.06 / 0.5 (bearing - 10), deviation 0.08."""
    objects, noise = predict(10.0, 0.5, 1)
    moved, _, beliefs = propose(objects, noise, measure(4, 11.0, 1.0))
    weight = beliefs.objects.log_weight[0, 0].exp()
    bearing, rate = moved.state[0, 0].unbind(-1)
    residual = rate - (0.2 + 0.12 * (bearing - 10))
    size = 1 / weight.square().sum()
    assert (weight * residual).sum().abs() < 5 * 0.08 / size**0.5
    deviation = (weight * residual.square()).sum().sqrt()
    assert deviation.item() == pytest.approx(0.08, rel=5 / (2 * float(size)) ** 0.5)


def test_particles_outside_of_the_region_have_no_weight():
    objects, noise = predict(69.5, 3.0, 1)
    moved, _, beliefs = propose(objects, noise, measure(4, 69.0, 0.05))
    outside = ~REGION.contains(moved.state)
    assert outside.any()
    assert moved.log_weight[outside].eq(-torch.inf).all()
    assert beliefs.objects.log_weight[outside].eq(-torch.inf).all()
    assert moved.log_weight[~outside].isfinite().all()


def test_an_object_wholly_outside_does_not_exist():
    objects, noise = predict(90.0, 0.5, 1, log_odds=5.0)
    _, _, beliefs = propose(objects, noise, measure(4, 69.0, 1.0))
    assert beliefs.objects.log_odds.eq(-torch.inf).all()
    assert beliefs.strength.eq(0).all()
    assert beliefs.objects.log_weight.isfinite().all()
