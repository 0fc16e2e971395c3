"""Births in one step on a line array: evidence, score in mu_B and first covariance, whatever the cells."""

import math

import pytest
import scipy.stats
import torch
from oracles.arrays import complex_normal
from oracles.births import one_object, two_objects
from oracles.line_array import BEARING, SMALL, make_field
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.core.weights import normalise
from torchdt.filter.bp.evidence import SampledEvidence
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.intensity.settings import Ignored
from torchdt.filter.interference.settings import NoInterference
from torchdt.filter.proposal.adapted import Adapted
from torchdt.model.birth import Birth, UniformBirth
from torchdt.model.birth_areas import AreaBirth
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.model import Model
from torchdt.model.noise.base import Noise
from torchdt.model.prior import Priors
from torchdt.model.region import Coordinate, Region

pytestmark = pytest.mark.slow
F64 = torch.float64
ETA, POWER, LIMIT, BIRTH_MEAN, SNAPSHOTS = 0.0125, 0.125, 1.0, 0.1, 3
FIELD = make_field()


def measure(rng: torch.Generator, *bearings: float) -> Measurement:
    """One step of sources 10 dB above the noise of an element."""
    z = ETA**0.5 * complex_normal(rng, 2, SNAPSHOTS, 8)
    for bearing in bearings:
        a = FIELD(torch.tensor([bearing], dtype=F64))
        z = z + POWER**0.5 * complex_normal(rng, 2, SNAPSHOTS, 1) * a[:, None]
    return from_snapshots(z)


def step(
    measurement: Measurement, cell: float, birth: Birth | None = None, **config
) -> tuple[TrackHistory, Tensor, Tensor]:
    """The first step of a batch `(B,)` of measurements.

    Returns:
        Estimates; evidence over noise alone `(B,)`; the logarithm of mu_B that it depends on.
    """
    runs = measurement.num_snapshots.shape[0]
    settings = (
        SMALL
        | {
            "particles": 500,
            "proposal": Adapted(rounds=4, round_size=128),
            "power_points": 24,
            "evidence": SampledEvidence(256),
        }
        | config
    )
    region = Region([Coordinate(**(BEARING | {"cell": cell}))], F64)
    model = Model(birth=birth or UniformBirth())
    # The oracles know objects and noise alone: what sounds where no object can be is noise to them.
    config = TrackerConfig(**settings, undetected=Ignored(), interference=NoInterference())
    tracker = DirectTracker(FIELD, region, 1.0, config, model)
    log_mean = torch.tensor(BIRTH_MEAN, dtype=F64).log().requires_grad_()
    tracker = tracker.with_model(tracker.model.with_numbers({"birth_mean": log_mean.exp()}))
    limit = torch.full((runs, 2), LIMIT, dtype=F64)
    priors = Priors(limit, limit)
    variance = torch.full((runs, 2, SMALL["noise_points"]), ETA, dtype=F64)
    state = tracker.init(priors)._replace(noise=Noise(variance, normalise(torch.zeros_like(variance))[0]))
    streams = RandomStreams.from_seeds(range(runs), (runs,), F64)
    _, estimate = tracker.step(state, measurement, priors, streams)
    energy = measurement.num_snapshots * measurement.energy
    alone = -measurement.num_snapshots * 8 * math.log(math.pi * ETA) - energy / ETA
    return estimate, estimate.log_evidence - alone.sum(-1), log_mean


def repeated(measurement: Measurement, runs: int) -> Measurement:
    return Measurement(*(t.expand(runs, *t.shape) for t in measurement))


def bearings(low: float, high: float, cell: float) -> Tensor:
    return torch.arange(low + cell / 2, high, cell, dtype=F64)


def exact(measurement: Measurement, *sources: float) -> tuple[float, float]:
    """Evidence over noise alone and its derivative in log mu_B."""
    settings = measurement.factor, SNAPSHOTS, ETA, LIMIT
    x = bearings(-70, 70, 0.05)
    orders = [0.0, (one_object(FIELD, x, *settings).logsumexp(-1) + math.log(0.05 / 140)).item()]
    if len(sources) == 2:  # everything but pairs within seven degrees of them is e^-10 of it
        x, y = (bearings(b - 7, b + 7, 0.25) for b in sources)
        pairs = two_objects(FIELD, x, y, *settings).flatten().logsumexp(-1)
        orders.append(pairs.item() + 2 * math.log(0.25 / 140))  # either order, over two
    terms = torch.tensor([t + n * math.log(BIRTH_MEAN) for n, t in enumerate(orders)], dtype=F64)
    number = (terms.softmax(0) * torch.arange(len(orders))).sum()
    return (terms.logsumexp(0) - BIRTH_MEAN).item(), (number - BIRTH_MEAN).item()


@pytest.mark.parametrize("sources", [(14.6,), (-10.0, 25.0)])
def test_evidence_and_score_do_not_depend_on_the_cells(sources):
    """Cells of 0.5 to 14 degrees, likelihoods of half a degree: within 0.03 nats of quadrature, and the score
    within 0.01. Boxes of 14 degree cells overlap."""
    measurement = measure(torch.Generator().manual_seed(1), *sources)
    expected, expected_score = exact(measurement, *sources)
    for cell in (0.5, 2.0, 14.0):
        _, evidence, log_mean = step(repeated(measurement, 6), cell)
        (score,) = torch.autograd.grad(evidence.mean(), log_mean)
        assert evidence.mean().item() == pytest.approx(expected, abs=0.03), cell
        assert score.item() == pytest.approx(expected_score, abs=0.01), cell


def test_first_covariance_is_that_of_the_error():
    """200 sources uniform in bearing: errors squared over variances have mean one. Bounds of a chi-square
    of as many degrees of freedom at 1e-5, half of it on either side; boxes of one cell would give 3."""
    runs, rng = 200, torch.Generator().manual_seed(5)
    truth = torch.rand(runs, generator=rng, dtype=F64) * 120 - 60
    scenes = [measure(rng, bearing) for bearing in truth.tolist()]
    measurement = Measurement(*(torch.stack(parts) for parts in zip(*scenes, strict=True)))
    with torch.no_grad():
        estimate, _, _ = step(measurement, 0.5, evidence=SampledEvidence(1), births=1)
    seen = estimate.declared[:, 0]
    assert seen.sum() > 0.9 * runs
    error = (estimate.state[:, 0, 0] - truth) / estimate.state_std[:, 0, 0]
    low, high = scipy.stats.chi2.ppf([5e-6, 1 - 5e-6], int(seen.sum())) / int(seen.sum())
    assert low < error[seen].square().mean() < high


AREAS = ({"low": [-70.0], "high": [-40.0], "weight": 3.0}, {"low": [14.0], "high": [20.0]})
"""In one of which three of four objects are born, and in the other one of four."""


def density(x: Tensor) -> Tensor:
    """Of births at bearings, per degree and per object born."""
    far, near = (((a["low"][0] < x) & (x < a["high"][0])).to(x) for a in AREAS)
    return 0.75 * far / 30 + 0.25 * near / 6


@pytest.mark.parametrize(("bearing", "cell"), [(16.0, 2.0), (-40.4, 0.5), (13.2, 2.0), (45.0, 2.0)])
def test_births_in_areas_have_their_density(bearing, cell):
    """Sources in an area, at its edge, beside it and far from all, so that likelihoods are cut off: within
    0.06 nats of quadrature over the density, the score within 0.01, and no object where none is born."""
    measurement = measure(torch.Generator().manual_seed(1), bearing)
    x = bearings(-70, 70, 0.05)
    log_ratio = one_object(FIELD, x, measurement.factor, SNAPSHOTS, ETA, LIMIT)
    one = (log_ratio + density(x).log()).logsumexp(-1).item() + math.log(0.05 * BIRTH_MEAN)
    expected, number = math.log1p(math.exp(one)) - BIRTH_MEAN, 1 / (1 + math.exp(-one))
    estimate, evidence, log_mean = step(repeated(measurement, 6), cell, AreaBirth(areas=AREAS))
    (score,) = torch.autograd.grad(evidence.mean(), log_mean)
    assert evidence.mean().item() == pytest.approx(expected, abs=0.06)
    assert score.item() == pytest.approx(number - BIRTH_MEAN, abs=0.01)
    assert estimate.declared.sum(-1).eq(round(number)).all()
    assert (density(estimate.state[..., 0][estimate.declared]) > 0).all()


def test_an_area_of_the_whole_region_is_a_uniform_birth():
    measurement = repeated(measure(torch.Generator().manual_seed(1), 14.6), 2)
    everywhere = AreaBirth(areas=[{"low": [-70.0], "high": [70.0]}])
    found, expected = (step(measurement, 2.0, birth) for birth in (everywhere, None))
    torch.testing.assert_close(found[1], expected[1], rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(found[0].state, expected[0].state, rtol=1e-9, atol=1e-9)
