"""Sampled evidence of one object with a Gaussian prediction on a line array, against quadrature."""

import math

import pytest
import torch
from oracles.arrays import direct_log_likelihood
from oracles.line_array import make_field, make_region, simulate
from oracles.scenes import repeat
from torch import Tensor
from torch.distributions import Normal
from torch.nn.functional import logsigmoid

from torchdt.core.mixture import GaussianMixture
from torchdt.core.random import RandomStreams
from torchdt.filter.bp.beliefs import initial_beliefs
from torchdt.filter.bp.configurations import UniformDraws, draw_configurations
from torchdt.filter.bp.evidence import sampled_evidence
from torchdt.filter.bp.update import update
from torchdt.filter.proposal.moved import Draws, propose_adapted, respond
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.noise.base import Noise

F64 = torch.float64
FIELD, REGION, PARTICLES, SAMPLES, RUNS = make_field(), make_region(), 5000, 256, 8
POWER, LOG_POWER = torch.logspace(-1, 1, 5, dtype=F64), torch.linspace(1, 0, 5, dtype=F64).log_softmax(-1)
# Unknown by a factor of four around the variance of the simulator.
NOISE = 0.0125 * torch.logspace(-0.3, 0.3, 4, dtype=F64)
LOG_NOISE = torch.linspace(0, 1, 4, dtype=F64).log_softmax(-1)


def measure(bearing: float, power_db: float) -> Measurement:
    """One step of four snapshots."""
    path = ((0.0, bearing), (1.0, bearing))
    return from_snapshots(simulate(4, path, steps=1, powers_db=(power_db,), num_snapshots=4)[0][0])


def sample(measurement: Measurement, mean: float, deviation: float, log_odds: float) -> Tensor:
    """Independent sampled evidences `(RUNS,)` on particles of an adapted proposal."""
    covariance = torch.tensor([[deviation**2, 0.06 * deviation], [0.06 * deviation, 0.01]], dtype=F64)
    centre, one = torch.tensor([mean, 0.2], dtype=F64), (RUNS, 1, 1)
    tril = torch.linalg.cholesky(covariance).expand(*one, -1, -1)
    density = GaussianMixture(torch.zeros(one, dtype=F64), centre.expand(*one, -1), tril)
    predicted = Objects(  # the proposal reads the density, not these particles
        centre.expand(RUNS, 1, PARTICLES, -1),
        torch.full((RUNS, 1, PARTICLES), -math.log(PARTICLES), dtype=F64),
        POWER.expand(RUNS, 1, 2, -1),
        LOG_POWER.expand(RUNS, 1, 2, -1),
        torch.full((RUNS, 1), log_odds, dtype=F64),
        torch.ones(RUNS, 1, dtype=torch.int64),
        torch.ones(RUNS, 1, PARTICLES, dtype=F64),
    )
    noise = Noise(NOISE.expand(RUNS, 2, -1), LOG_NOISE.expand(RUNS, 2, -1))
    measurement, streams = repeat(measurement, RUNS), RandomStreams.from_seeds(range(RUNS), (RUNS,), F64)
    initial = initial_beliefs(predicted, respond(FIELD, predicted.state), noise)
    draws = Draws(streams.normal(1, 4, 128, 1), streams.normal(1, PARTICLES, 2))
    prior, response, first = propose_adapted(FIELD, REGION, predicted, density, initial, measurement, draws)
    beliefs = update(prior, response, noise, measurement, sweeps=2, initial=first)
    uniform = UniformDraws.draw(streams, 1, 2, SAMPLES)
    drawn = draw_configurations(
        [beliefs.objects], torch.ones(RUNS, 1, dtype=torch.bool), beliefs.noise, uniform
    )
    return sampled_evidence(prior, response, noise, measurement, drawn)


def quadrature(measurement: Measurement, mean: float, deviation: float, log_odds: float) -> float:
    """Direct Gaussian likelihoods over bearing in the region, power and noise of every tone."""
    low, high = max(-70, mean - 8 * deviation), min(70, mean + 8 * deviation)
    grid = torch.linspace(low, high, 2001, dtype=F64)
    log_prior = Normal(mean, deviation).log_prob(grid).log_softmax(-1)
    response = FIELD(grid[:, None])
    there, nothing = log_prior, torch.zeros((), dtype=F64)
    for i in range(2):
        z, outer = measurement.factor[i].mT, response[:, i, :, None] * response[:, i, None, :].conj()
        white = NOISE[:, None, None] * torch.eye(8, dtype=outer.dtype)
        covariance = POWER[:, None, None, None] * outer[:, None, None] + white  # (X, G, E, M, M)
        joint = direct_log_likelihood(z, covariance) + LOG_POWER[:, None] + LOG_NOISE
        there = there + joint.logsumexp((-2, -1))
        nothing = nothing + (direct_log_likelihood(z, white) + LOG_NOISE).logsumexp(-1)
    exists, absent = logsigmoid(torch.tensor([log_odds, -log_odds], dtype=F64))
    return torch.logaddexp(exists + there.logsumexp(-1), absent + nothing).item()


@pytest.mark.parametrize(
    ("mean", "deviation", "bearing", "power_db", "log_odds"),
    [
        (10.0, 0.5, 10.4, 0.0, 2.0),  # tracking
        (10.0, 6.0, 16.0, 10.0, -2.0),  # a sharp likelihood in a wide prediction
        (10.0, 0.05, 10.1, -10.0, 0.0),  # the prediction knows more than the data
        (69.0, 1.5, 68.6, 0.0, 2.0),  # partly outside of the region
        (10.0, 0.5, 10.4, -100.0, 2.0),  # nothing there
    ],
)
def test_equals_quadrature(mean, deviation, bearing, power_db, log_odds):
    """No other objects, so no loops but those through the unknown noise. Every run is within 0.1 nats, their
    mean within 0.05, which is ten of its standard errors in the worst case."""
    measurement = measure(bearing, power_db)
    exact = quadrature(measurement, mean, deviation, log_odds)
    error = sample(measurement, mean, deviation, log_odds) - exact
    assert error.abs().max() < 0.1
    assert error.mean().abs() < 0.05
