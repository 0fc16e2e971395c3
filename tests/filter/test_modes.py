"""Objects that may be in one of several places: what becomes of their beliefs from step to step."""

import math

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.grid_filter import Grid
from oracles.grid_filter import run as run_on_grid
from oracles.likelihood import frozen_proposals, rewind
from oracles.line_array import FREQS, POSITIONS, make_tracker
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.core.weights import normalise
from torchdt.field.plane_wave import LineArrayField
from torchdt.filter.bp.evidence import SampledEvidence
from torchdt.filter.bp.messages import state_message
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.direct import DirectTracker
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.moved import respond
from torchdt.filter.state import TrackerState
from torchdt.model.measurement import Measurement, from_snapshots, mask_covariance
from torchdt.model.motion.driving import Reparameterised, Score
from torchdt.model.prior import Priors
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
RUNS, PARTICLES, ETA, POWER, DRIVING = 20, 500, 0.0125, 0.01, 0.15
SETTINGS = {
    "particles": PARTICLES,
    "power_shape": 1e8,
    "noise_shape": 1e8,
    "birth_mean": 1e-15,
    "evidence": SampledEvidence(256),
    "prune": 1e-9,
}


def started(
    tracker: DirectTracker, modes: list[float], shares: list[float], deviation: float
) -> TrackerState:
    """One object that exists, in modes of the same deviation and with rates of a deviation of 0.05."""
    limit = torch.full((RUNS, 2), 1.0, dtype=F64)
    state, rng = tracker.init(Priors(limit, limit)), torch.Generator().manual_seed(3)
    number = tracker.config.particles
    raw = torch.randn(RUNS, number, 2, generator=rng, dtype=F64)
    counts = torch.tensor([round(share * number) for share in shares])
    centre = torch.tensor(modes, dtype=F64).repeat_interleave(counts)
    particles = raw * torch.tensor([deviation, 0.05]) + torch.stack([centre, torch.zeros_like(centre)], -1)
    objects = state.objects._replace(
        state=torch.cat([particles[:, None], state.objects.state[:, 1:]], 1),
        power=torch.full_like(state.objects.power, POWER),
        log_odds=state.objects.log_odds.index_fill(-1, torch.tensor([0]), math.log(9)),
    )
    objects = objects._replace(log_power_weight=normalise(torch.zeros_like(objects.power))[0])
    noise = state.noise._replace(variance=torch.full_like(state.noise.variance, ETA))
    noise = noise._replace(log_weight=normalise(torch.zeros_like(noise.variance))[0])
    return state._replace(objects=objects, noise=noise)


def masses(state: TrackerState, modes: list[float], reach: float = 3.0) -> Tensor:
    """Probability within a reach of each mode, given existence, `(RUNS, len(modes))`."""
    position, weight = state.objects.state[:, 0, :, 0], state.objects.log_weight[:, 0].exp()
    near = (position[:, None] - torch.tensor(modes, dtype=F64)[:, None]).abs() < reach
    return (near * weight[:, None]).sum(-1)


def on_the_left(state: TrackerState) -> Tensor:
    """Probability of bearings below zero, given existence, `(RUNS,)`."""
    left = state.objects.state[:, 0, :, 0] < 0
    return (left * state.objects.log_weight[:, 0].exp()).sum(-1)


def run(tracker: DirectTracker, state: TrackerState, data: Measurement) -> tuple[list[TrackerState], Tensor]:
    """The state after every step, and the evidence `(RUNS, K)`."""
    limit = torch.full((RUNS, 2), 1.0, dtype=F64)
    priors, streams = Priors(limit, limit), RandomStreams.from_seeds(range(RUNS), (RUNS,), F64)
    states, found = [], []
    for k in range(data.num_snapshots.shape[0]):
        one = Measurement(*(t.expand(RUNS, *t.shape) for t in data.at(k)))
        state, estimate = tracker.step(state, one, priors, streams)
        states.append(state)
        found.append(estimate.log_evidence)
    return states, torch.stack(found, -1)


NO_DATA = from_snapshots(torch.full((5, 2, 3, 8), torch.nan, dtype=torch.complex128))


@pytest.mark.parametrize(
    ("modes", "shares"),
    [([-20.0, 20.0], [0.5, 0.5]), ([-20.0, 20.0], [0.7, 0.3]), ([-20.0, 0.0, 20.0], [0.5, 0.3, 0.2])],
)
def test_modes_stay_without_data(modes, shares):
    """What is near the modes stays there, in every run; the share of each stays on average: within 5 standard
    errors, false alarm of 1e-5."""
    tracker = make_tracker(**SETTINGS)
    states, found = run(tracker, started(tracker, modes, shares, 0.5), NO_DATA)
    assert found.eq(0).all()
    for state in states:
        mass = masses(state, modes)
        assert mass.sum(-1).min() > 0.97
        error = mass.std(0) / RUNS**0.5
        assert ((mass.mean(0) - torch.tensor(shares)).abs() < 5 * error + 1e-3).all()


def test_one_gaussian_is_an_assumed_density():
    """Of modes at +-20 it leaves 0.18 within 3 of them, the mass of a deviation of 20."""
    tracker = make_tracker(**SETTINGS, proposal=Adapted(1, 4, 64))
    (state, *_), _ = run(tracker, started(tracker, [-20.0, 20.0], [0.5, 0.5], 0.5), NO_DATA.at(slice(1)))
    normal = torch.distributions.Normal(0.0, 20.0)
    expected = 2 * (normal.cdf(torch.tensor(23.0)) - normal.cdf(torch.tensor(17.0)))
    assert masses(state, [-20.0, 20.0]).sum(-1).mean().item() == pytest.approx(expected.item(), abs=0.02)


class MirroredArray(LineArrayField):
    """A line array that hears an object on the left as one on the right, a degree further out."""

    def forward(self, state: Tensor) -> Tensor:
        """Responses `(*batch, I, M)`."""
        return super().forward(torch.where(state[..., :1] < 0, 1.0 - state[..., :1], state[..., :1]))


FIELD = MirroredArray(FREQS, POSITIONS, dtype=F64)
REGION = Region([Coordinate("bearing", "deg", -40, 40, 2, -1, 1, DRIVING**2)], F64)


def recording() -> Measurement:
    """An object at 20.2, 20.4 and 20.6 degrees, or at -19.2, -19.4 and -19.6."""
    rng, steps = torch.Generator().manual_seed(2), []
    for bearing in (20.2, 20.4, 20.6):
        a = FIELD(torch.tensor([bearing], dtype=F64))
        z = ETA**0.5 * complex_normal(rng, 2, 3, 8) + POWER**0.5 * complex_normal(rng, 2, 3, 1) * a[:, None]
        steps.append(z)
    return from_snapshots(torch.stack(steps))


def exact(
    data: Measurement, modes: list[float], shares: list[float], deviation: float
) -> tuple[Tensor, Tensor]:
    """Evidence over noise alone `(K,)`, and the probability to exist on either side `(K, 2)`."""
    grid = Grid.over(-40, 40, (-1.5, 1.5), DRIVING)
    position = sum(
        share * torch.distributions.Normal(mode, deviation).log_prob(grid.bearing).exp()
        for mode, share in zip(modes, shares, strict=True)
    )
    rate = torch.distributions.Normal(0.0, 0.05).log_prob(grid.rate).exp()
    start = 0.9 * position[:, None] * rate / (position.sum() * rate.sum())
    nothing = torch.zeros(3, 2, 8, 8, dtype=torch.complex128)
    background = mask_covariance(nothing, torch.full((3, 2), ETA, dtype=F64), data.present)
    power = torch.full((3, 2, 1), POWER, dtype=F64)
    response = respond(FIELD, grid.bearing[:, None]).expand(3, -1, -1, -1)
    message = state_message(whiten(data, background), response, power, torch.zeros_like(power))
    found, density = run_on_grid(grid, start, DRIVING, torch.tensor(0.95, dtype=F64), message.exp())
    left = grid.bearing < 0
    return found, torch.stack([density[:, left].sum((-2, -1)), density[:, ~left].sum((-2, -1))], -1)


def mirrored(**settings) -> DirectTracker:
    """A tracker that cannot tell the sides apart."""
    small = make_tracker(**(SETTINGS | settings))
    return DirectTracker(FIELD, REGION, 1.0, small.config, small.model)


@pytest.mark.parametrize(
    ("modes", "shares", "deviation", "nats"),
    [([-19.5, 20.0], [0.6, 0.4], 1.0, 0.03), ([0.5], [1.0], 12.0, 0.1)],
)
def test_both_modes_of_a_likelihood_are_weighed(modes, shares, deviation, nats):
    """Both sides fit about as well, for an object predicted on either of them or anywhere.

    On average over the runs evidence and probability of either side are near the exact filter's after each of
    three steps: five standard errors, and room for clusters of weak data, which are no Gaussians. One
    Gaussian for both sides is wrong by 0.9 nats in the first case and by 0.16 in the second.
    """
    data = recording()
    expected, sides = exact(data, modes, shares, deviation)
    tracker = mirrored()
    states, found = run(tracker, started(tracker, modes, shares, deviation), data)
    count, energy = data.num_snapshots, data.energy
    alone = (-count * 8 * math.log(math.pi * ETA) - energy * count / ETA).sum(-1)
    existence = torch.stack([state.objects.existence[:, 0] for state in states], -1)
    left = torch.stack([on_the_left(state) for state in states], -1)
    mass = torch.stack([left, 1 - left], -1) * existence[..., None]
    torch.testing.assert_close((found - alone).mean(0), expected, rtol=0, atol=nats)
    torch.testing.assert_close(mass.mean(0), sides, rtol=0, atol=nats / 2 + 0.005)


NUMBERS = {
    "survival": torch.tensor(0.95, dtype=F64),
    "driving_variance": torch.tensor([DRIVING**2], dtype=F64),
}


@pytest.mark.slow
@pytest.mark.parametrize("gradient", [Score(), Reparameterised()])
def test_gradient_of_two_modes_equals_finite_differences(gradient):
    """Through shares, means and covariances of the modes; proposals stand still. Relative error 1e-5."""
    tracker, data = mirrored(gradient=gradient, particles=60), recording()
    start = started(tracker, [-19.5, 20.0], [0.6, 0.4], 1.0)

    def value(numbers: dict[str, Tensor]) -> Tensor:
        return run(tracker.with_model(tracker.model.with_numbers(numbers)), start, data)[1].sum()

    leaves = {name: number.clone().requires_grad_() for name, number in NUMBERS.items()}
    with frozen_proposals() as tapes:
        slopes = torch.autograd.grad(value(leaves), list(leaves.values()))
        for (name, at), slope in zip(NUMBERS.items(), slopes, strict=True):
            if gradient == Score() and name == "driving_variance":
                continue  # moves particles, which is no part of it
            ends = []
            for step in (1e-5, -1e-5):
                rewind(tapes)
                ends.append(value(NUMBERS | {name: at * (1 + step)}))
            difference = (ends[0] - ends[1]) / (2e-5 * at)
            assert slope.item() == pytest.approx(difference.item(), rel=1e-5), name
