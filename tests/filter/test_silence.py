"""Objects that fall silent: against an exact filter, and what is reported of them."""

import math

import pytest
import torch
from oracles.line_array import SMALL, make_field, make_region, simulate
from oracles.switching import switching_filter

from torchdt.core.random import RandomStreams
from torchdt.filter.bp.evidence import SampledEvidence
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.intensity.settings import Ignored
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.model.measurement import from_snapshots, gaussian_log_likelihood
from torchdt.model.model import Model
from torchdt.model.motion.constant_position import ConstantPosition
from torchdt.model.noise.white import WhiteNoise
from torchdt.model.power.gamma import GammaPower
from torchdt.model.power.switched import SwitchedPower, SwitchedTones
from torchdt.model.prior import Priors, data_priors

F64 = torch.float64
RATES = {"falls_silent": 0.1, "resumes": 0.3}
NUMBERS = {"survival": 0.93, **RATES}
POWER, NOISE, WALK, EXISTENCE, START = 4.0, 1.0, 0.7, 0.8, (5.0, 3.0)
SENDING = (1, 1, 0, 0, 0, 1, 1, 0)
PARTICLES, RUNS = 3000, 8
PROPOSALS = pytest.mark.parametrize("proposal", [Adapted(), AsPredicted()], ids=["adapted", "as predicted"])


def snapshots_of(*sending: tuple[int, ...]) -> torch.Tensor:
    """Of a source at 6 degrees that sends each tone in these steps, `(K, I, J, M)`; 3 dB below the noise."""
    rng = torch.Generator().manual_seed(1)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=rng, dtype=torch.complex128)

    response = make_field()(torch.tensor([[6.0]], dtype=F64))[0]
    sent = torch.tensor(sending, dtype=F64).T[..., None, None]
    size = *sent.shape[:2], 3
    signal = math.sqrt(POWER) * sent * normal(*size, 1) * response[:, None]
    return signal + math.sqrt(NOISE) * normal(*size, 8)


TOGETHER = snapshots_of(SENDING, SENDING)


def tracker_of(proposal, power, **numbers) -> DirectTracker:
    """Of one power and one level of the noise, which are known then, and of no births to speak of."""
    config = TrackerConfig(
        slots=2,
        particles=PARTICLES,
        births=1,
        power_points=1,
        noise_points=1,
        proposal=proposal,
        undetected=Ignored(),
        evidence=SampledEvidence(1000),
        prune=1e-6,
    )
    model = Model(motion=ConstantPosition([WALK**2]), power=power, noise=WhiteNoise(1e12))
    tracker = DirectTracker(make_field(), make_region(), 1.0, config, model)
    return tracker.with_model(tracker.model.with_numbers({"birth_mean": 1e-12} | NUMBERS | numbers))


def run(tracker: DirectTracker, data: torch.Tensor) -> list[torch.Tensor]:
    """What `Exact` holds, `(RUNS, K)` each, from an object that transmits."""
    streams, one = RandomStreams.from_seeds(range(RUNS), (RUNS,), F64), torch.ones(RUNS, 2, dtype=F64)
    state, measurement, steps = tracker.init(Priors(one, one)), from_snapshots(data), []
    objects = state.objects
    place, odds = objects.state.clone(), objects.log_odds.clone()
    place[:, 0] = START[0] + START[1] * streams.normal(PARTICLES, 1)
    odds[:, 0] = math.log(EXISTENCE / (1 - EXISTENCE))
    power = POWER * (objects.power > 0).to(F64)
    weight = torch.zeros_like(objects.log_power_weight)
    weight[..., 1:] = -torch.inf
    objects = objects._replace(state=place, log_odds=odds, power=power, log_power_weight=weight)
    noise = state.noise._replace(variance=torch.full_like(state.noise.variance, NOISE))
    state = state._replace(objects=objects, noise=noise)
    for k in range(len(data)):
        now = type(measurement)(*(t[k].expand(RUNS, *t.shape[1:]) for t in measurement))
        state, estimate = tracker.step(state, now, Priors(one, one), streams)
        alone = NOISE * torch.eye(8, dtype=torch.complex128).expand(RUNS, 2, -1, -1)
        beliefs = (
            estimate.existence,
            estimate.transmission,
            estimate.state[..., 0],
            estimate.state_std[..., 0],
        )
        log_evidence = estimate.log_evidence - gaussian_log_likelihood(now, alone).sum(-1)
        steps.append([*(t[:, 0] for t in beliefs), log_evidence])
    return [torch.stack(column, -1) for column in zip(*steps, strict=True)]


def exact(data: torch.Tensor, together: bool = True, **numbers):
    x = torch.linspace(-40, 50, 901, dtype=F64)
    start = torch.exp(-0.5 * ((x - START[0]) / START[1]).square())
    numbers = {name: torch.as_tensor(value, dtype=F64) for name, value in (NUMBERS | numbers).items()}
    arguments = make_field(), data, x, start / start.sum(), EXISTENCE
    return switching_filter(*arguments, power=POWER, noise=NOISE, walk=WALK, together=together, **numbers)


# Of eight runs in the mean; one strays by up to .02, .02, .1, .06 and .04. In the second step, of 34 nats,
# the Gaussians that stand for the particles of the first cost some .025.
BARS = (0.015, 0.02, 0.12, 0.06, 0.05)


@PROPOSALS
def test_beliefs_and_evidence_are_those_of_an_exact_filter(proposal):
    expected = exact(TOGETHER)
    # Undecided in some steps, decided in others; dead is not told from silent.
    assert expected.transmission.min() < 0.05
    assert ((expected.transmission > 0.2) & (expected.transmission < 0.9)).sum() >= 4
    with torch.inference_mode():
        found = run(tracker_of(proposal, SwitchedPower(1e12)), TOGETHER)
    for one, other, bar in zip(found, expected, BARS, strict=True):
        torch.testing.assert_close(one.mean(0), other, rtol=0, atol=bar)
    assert (found[-1].mean(0) - expected.log_evidence).abs().mean() < 0.02


def test_tones_that_are_switched_on_their_own():
    """A projector takes one tone away, then the other: the object transmits all the time."""
    data = snapshots_of((1, 1, 0, 0, 0, 1, 1, 1), (1, 1, 1, 1, 1, 1, 0, 0))
    expected = exact(data, together=False)
    with torch.inference_mode():
        found = run(tracker_of(Adapted(), SwitchedTones(1e12)), data)
    # Which tones are sent is believed apart from where the object is.
    for one, other, bar in zip(found, expected, (0.03, 0.05, 0.3, 0.15, 0.1), strict=True):
        torch.testing.assert_close(one.mean(0), other, rtol=0, atol=bar)


@PROPOSALS
def test_gradients_are_those_of_the_exact_filter(proposal):
    """Of the sum over the steps, in the mean over eight runs."""
    values = {name: torch.tensor(value, dtype=F64, requires_grad=True) for name, value in NUMBERS.items()}
    expected = torch.autograd.grad(exact(TOGETHER, **values).log_evidence.sum(), tuple(values.values()))
    evidence = run(tracker_of(proposal, SwitchedPower(1e12), **values), TOGETHER)[-1]
    found = torch.autograd.grad(evidence.sum(-1).mean(), tuple(values.values()))
    assert min(map(abs, expected)) > 0.5
    torch.testing.assert_close(found, expected, rtol=0.05, atol=0.15)


def silent_scene(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A source that sends nothing in steps 10 to 14 of 20."""
    snapshots, truth = simulate(seed, ((0.0, 5.0), (20.0, 12.0)), steps=20, snr_db=10.0)
    noise, _ = simulate(seed + 100, ((0.0, 5.0), (20.0, 12.0)), steps=20, snr_db=10.0, powers_db=(-300.0,))
    snapshots[10:15] = noise[10:15]
    return snapshots, truth


def follow(power, seeds=(3,), scenes=(1,), **config):
    """History of a whole tracker, and the truth of the first scene."""
    data, truth = zip(*map(silent_scene, scenes), strict=True)
    measurement = from_snapshots(torch.stack(data))
    model = Model(power=power, survival=0.999)
    tracker = DirectTracker(make_field(), make_region(), 1.0, TrackerConfig(**(SMALL | config)), model)
    with torch.inference_mode():
        streams = RandomStreams.from_seeds(seeds, (len(seeds),), F64)
        return tracker.run(measurement, data_priors(measurement), streams), truth[0]


@PROPOSALS
def test_a_silent_object_keeps_its_label_and_is_where_it_was_going(proposal):
    history, truth = follow(SwitchedPower(falls_silent=0.02), proposal=proposal)
    declared = history.declared[0]
    assert (declared[1:].sum(-1) == 1).all()
    assert set(history.label[0][declared].tolist()) == {1}
    slot = declared.int().argmax(-1, keepdim=True)
    transmission = history.transmission[0].gather(-1, slot).squeeze(-1)
    assert transmission[11:15].max() < 0.1
    assert transmission[[5, 9, 16, 19]].min() > 0.9
    found = history.position[0, :, :, 0].gather(-1, slot).squeeze(-1)
    assert (found - truth[:, 0, 0])[1:].abs().max() < 2.0


def test_without_the_switch_it_is_dropped():
    history, _ = follow(GammaPower())
    assert not history.declared[0, 11:15].any()
    assert (history.transmission == 1).all()


def test_silent_objects_need_not_be_reported():
    reported, _ = follow(SwitchedPower(falls_silent=0.02), report_silent=False)
    assert not reported.declared[0, 11:15].any()
    assert set(reported.label[0][reported.declared[0]].tolist()) == {1}


@PROPOSALS
def test_a_sequence_in_a_batch_gives_what_it_gives_alone(proposal):
    power = SwitchedPower(falls_silent=0.02)
    together, _ = follow(power, (3, 4), (1, 2), proposal=proposal)
    alone, _ = follow(power, (4,), (2,), proposal=proposal)
    for name in ("existence", "transmission", "state", "log_evidence"):
        found, expected = getattr(together, name)[1], getattr(alone, name)[0]
        torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6)
