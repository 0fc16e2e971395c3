"""An object that walks out of the region: evidence and score against an exact filter on a grid."""

import math

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.grid_filter import BEARING_CELL, RATE_CELL, Grid, evidence
from oracles.line_array import SMALL, make_field
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.core.weights import normalise
from torchdt.filter.bp.evidence import SampledEvidence
from torchdt.filter.bp.messages import state_message
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.filter.proposal.base import Proposal
from torchdt.filter.proposal.moved import respond
from torchdt.filter.state import TrackerState
from torchdt.model.measurement import Measurement, from_snapshots, mask_covariance
from torchdt.model.model import Model
from torchdt.model.noise.base import Noise
from torchdt.model.prior import Priors
from torchdt.model.region import Coordinate, Region

pytestmark = pytest.mark.slow
F64 = torch.float64
ETA, POWER, DRIVING, RUNS, PARTICLES = 0.0125, 0.02, 0.15, 6, 800
FIELD = make_field()
REGION = Region([Coordinate("bearing", "deg", -10, 10, 2, -1, 1, DRIVING**2)], F64)
MEAN, DEVIATION, EXISTENCE = (7.9, 1.0), (0.4, 0.2), 0.9
LOG_ODDS = math.log(EXISTENCE / (1 - EXISTENCE))


def recording(seed: int) -> Measurement:
    """Bearings 9 and 9.8, then nothing for three steps: the object has left."""
    rng, steps = torch.Generator().manual_seed(seed), []
    for bearing in (9.0, 9.8, None, None, None):
        z = ETA**0.5 * complex_normal(rng, 2, 3, 8)
        if bearing is not None:
            a = FIELD(torch.tensor([bearing], dtype=F64))
            z = z + POWER**0.5 * complex_normal(rng, 2, 3, 1) * a[:, None]
        steps.append(z)
    return from_snapshots(torch.stack(steps))


def exact(measurement: Measurement, survival: Tensor) -> Tensor:
    """Evidence over noise alone, `(K,)`."""
    grid = Grid.over(-10, 10, (-0.5, 2.5), DRIVING)
    density = torch.ones(len(grid.bearing), len(grid.rate), dtype=F64)
    for axis, values in enumerate((grid.bearing[:, None], grid.rate)):
        density = density * torch.distributions.Normal(MEAN[axis], DEVIATION[axis]).log_prob(values).exp()
    start = EXISTENCE * density * BEARING_CELL * RATE_CELL
    nothing = torch.zeros(5, 2, 8, 8, dtype=torch.complex128)
    background = mask_covariance(nothing, torch.full((5, 2), ETA, dtype=F64), measurement.present)
    power = torch.full((5, 2, 1), POWER, dtype=F64)
    response = respond(FIELD, grid.bearing[:, None]).expand(5, -1, -1, -1)
    message = state_message(whiten(measurement, background), response, power, torch.zeros_like(power))
    return evidence(grid, start, DRIVING, survival, message.exp())


def started(tracker: DirectTracker, priors: Priors) -> TrackerState:
    """One object in the first slot, its particles of exactly the moments the grid starts from."""
    state, rng = tracker.init(priors), torch.Generator().manual_seed(3)
    raw = torch.randn(RUNS, PARTICLES, 2, generator=rng, dtype=F64)
    raw = raw - raw.mean(-2, keepdim=True)
    root = torch.linalg.cholesky(raw.mT @ raw / PARTICLES)
    raw = torch.linalg.solve_triangular(root.mT, raw, upper=True, left=False)
    particles = torch.tensor(MEAN, dtype=F64) + raw * torch.tensor(DEVIATION, dtype=F64)
    objects = state.objects._replace(
        state=torch.cat([particles[:, None], state.objects.state[:, 1:]], 1),
        power=torch.full_like(state.objects.power, POWER),
        log_odds=state.objects.log_odds.index_fill(-1, torch.tensor([0]), LOG_ODDS),
    )
    objects = objects._replace(log_power_weight=normalise(torch.zeros_like(objects.power))[0])
    variance = torch.full_like(state.noise.variance, ETA)
    noise = Noise(variance, normalise(torch.zeros_like(variance))[0])
    return state._replace(objects=objects, noise=noise)


def tracked(measurement: Measurement, survival: Tensor, proposal: Proposal) -> Tensor:
    """Evidence over noise alone of several runs of the tracker, `(RUNS, K)`."""
    settings = SMALL | {"particles": PARTICLES, "evidence": SampledEvidence(256), "prune": 1e-9}
    config = TrackerConfig(**settings | {"proposal": proposal})
    numbers = {"power_shape": 1e8, "noise_shape": 1e8, "birth_mean": 1e-15, "survival": survival}
    tracker = DirectTracker(FIELD, REGION, 1.0, config, Model().with_numbers(numbers))
    limit = torch.full((RUNS, 2), 1.0, dtype=F64)
    priors, streams = Priors(limit, limit), RandomStreams.from_seeds(range(RUNS), (RUNS,), F64)
    state, found = started(tracker, priors), []
    for k in range(5):
        one = Measurement(*(t.expand(RUNS, *t.shape) for t in measurement.at(k)))
        state, estimate = tracker.step(state, one, priors, streams)
        alone = -one.num_snapshots * 8 * math.log(math.pi * ETA) - one.energy * one.num_snapshots / ETA
        found.append(estimate.log_evidence - alone.sum(-1))
    return torch.stack(found, -1)


@pytest.mark.parametrize("proposal", [Adapted(rounds=4, round_size=64), AsPredicted()])
def test_leaving_is_a_death_that_survival_does_not_pay_for(proposal):
    """Total evidence within 0.1 nats, score in logit p_s within 0.05 of the exact filter's; the mass that
    leaves, given to nobody, would change the score by 0.8."""
    measurement = recording(1)
    logit = torch.tensor(math.log(0.95 / 0.05), dtype=F64, requires_grad=True)
    expected = exact(measurement, torch.sigmoid(logit)).sum()
    (expected_score,) = torch.autograd.grad(expected, logit)
    found = tracked(measurement, torch.sigmoid(logit), proposal).sum(-1).mean()
    (score,) = torch.autograd.grad(found, logit)
    assert found.item() == pytest.approx(expected.item(), abs=0.1)
    assert score.item() == pytest.approx(expected_score.item(), abs=0.05)
