"""The tracker on the paper's graph, on a line array: 8 sensors, 2 tones, bearings."""

import math

import pytest
import torch
from oracles.line_array import FREQS, POSITIONS, SMALL_PAPER, make_field, make_region, simulate

from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.data.recording import validate
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.history import TrackHistory
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.tracker import PaperTracker
from torchdt.model.birth import UniformBirth
from torchdt.model.measurement import from_snapshots
from torchdt.model.model import Model
from torchdt.model.power.gamma import GammaPower
from torchdt.model.prior import data_priors

F64 = torch.float64
TWO = (((0.0, -40.0), (20.0, -25.0)), ((0.0, 30.0), (20.0, 20.0)))

OFTEN = Model(birth=UniformBirth(birth_mean=0.01))


def make_tracker(field=None, model: Model = OFTEN, **config) -> PaperTracker:
    settings = PaperConfig(**(SMALL_PAPER | config))
    return PaperTracker(field or make_field(), make_region(), 1.0, settings, model)


def streams(*seeds: int) -> RandomStreams:
    return RandomStreams.from_seeds(seeds, (len(seeds),), F64)


def run(tracker: PaperTracker, snapshots: torch.Tensor, *seeds: int) -> TrackHistory:
    measurement = from_snapshots(snapshots)
    return tracker.run(measurement, data_priors(measurement), streams(*seeds))


@pytest.fixture(scope="module")
def snapshots() -> torch.Tensor:
    return torch.stack([simulate(seed, *TWO)[0][:12] for seed in range(2)])


@pytest.fixture(scope="module")
def history(snapshots) -> TrackHistory:
    return run(make_tracker(), snapshots, 0, 1)


def test_two_sources_are_found_and_followed(history, snapshots):
    truth = simulate(0, *TWO)[1][11, :, 0]
    for b in range(2):
        declared = history.declared[b, 11]
        found = history.position[b, 11, :, 0][declared].sort().values
        torch.testing.assert_close(found, truth.sort().values, rtol=0, atol=1.5)
        # Each keeps the label it got in the first steps.
        assert sorted(history.label[b, 11][declared].tolist()) == sorted(
            history.label[b, 4][history.declared[b, 4]].tolist()
        )


def test_the_history_is_sound(history):
    assert history.log_evidence.isnan().all()
    for name, values in history._asdict().items():
        assert name == "log_evidence" or values.double().isfinite().all(), name
    assert (history.noise > 0).all()
    assert not history.failed.any()
    assert (history.label[history.declared] > 0).all()


def test_a_sequence_does_not_depend_on_its_batch(history, snapshots):
    alone = run(make_tracker(), snapshots[1:], 1)
    there = history.existence[1] > 0
    for name in ("existence", "declared", "noise"):
        torch.testing.assert_close(getattr(alone, name)[0], getattr(history, name)[1], rtol=1e-6, atol=1e-9)
    for name in ("label", "state", "power"):
        found, expected = (getattr(h, name)[b][there] for h, b in ((alone, 0), (history, 1)))
        torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-9)


def test_fields_of_each_sequence(snapshots):
    """The second array is turned over: its sources appear on the other side."""
    turned = [-p for p in POSITIONS]
    fields = [LineArrayField(FREQS, positions, dtype=F64) for positions in (POSITIONS, turned)]
    both = make_tracker(StackedField(fields), iterations=2)
    data = snapshots[:1, :3].expand(2, -1, -1, -1, -1)
    history = run(both, data, 0, 1)
    alone = run(both.select(slice(1, 2)), data[1:], 1)
    torch.testing.assert_close(alone.existence[0], history.existence[1], rtol=1e-6, atol=1e-9)
    one = make_tracker()
    assert one.select(slice(0, 1)) is one


def test_transitions_are_those_of_the_model():
    """Mean and variance of powers and noise after one step without data, z-scores below 5.2 (2e-7 each).

    Powers of one particle start from a single value; noise starts from particles spread over [0, 1].
    """
    number = 20_000
    sizes = {"slots": 1, "particles": 3, "births": 1}
    sizes |= {"power_particles": number, "noise_particles": number}
    tracker = make_tracker(model=Model(power=GammaPower(power_shape=50.0)), **sizes)
    measurement = from_snapshots(simulate(0, *TWO, steps=1)[0][:1])
    priors = data_priors(measurement)
    ones = type(priors)(*(torch.ones_like(t) for t in priors))
    state = tracker.init(ones)
    exists = state.objects.log_odds.new_full(state.objects.log_odds.shape, 3.0)
    objects = state.objects._replace(log_odds=exists, power=2.0 * torch.ones_like(state.objects.power))
    draws = tracker.draw(RandomStreams.from_seeds([0], (), F64))
    known = tracker.predict_objects(objects, draws)
    assert known.existence.item() == pytest.approx(0.95 / (1 + math.exp(-3.0)))
    mean, variance = 2.0, 2.0**2 / 50
    for power in known.power[0]:
        assert abs(power.mean().item() - mean) < 5.2 * (variance / number) ** 0.5
        assert abs(power.var().item() / variance - 1) < 5.2 * ((2 + 6 / 50) / number) ** 0.5
    new, _ = tracker.step(state, measurement.at(0).silent(), ones, RandomStreams.from_seeds([0], (), F64))
    # E[eta] = 1/2 and E[eta^2] = (1 + 1 / c) / 3 for eta uniform up to one, times a Gamma of mean one.
    noise = new.noise.variance
    variance = 1.01 / 3 - 0.25
    assert (noise.mean(-1) - 0.5).abs().max() < 5.2 * (variance / number) ** 0.5
    # Of eta^2 the variance is at most its fourth moment, 1.06 / 5.
    assert (noise.square().mean(-1) - 1.01 / 3).abs().max() < 5.2 * (1.07 / 5 / number) ** 0.5


def test_an_object_ends_where_it_leaves_the_region():
    tracker = make_tracker()
    state = tracker.init(data_priors(from_snapshots(simulate(0, *TWO, steps=1)[0])))
    objects = state.objects
    where = torch.tensor([69.9, 69.9, 0.0, 0.0], dtype=F64)[:, None]
    rate = torch.tensor([9.0, 0.09, 0.0, 0.0], dtype=F64)[:, None]
    moving = torch.stack([where, rate], -1).expand_as(objects.state)
    objects = objects._replace(state=moving, log_odds=torch.tensor([2.0, 2.0, 2.0, -math.inf], dtype=F64))
    known = tracker.predict_objects(objects, tracker.draw(RandomStreams.from_seeds([0], (), F64)))
    # The second one is only partly outside. The region is the support of the states; they know no existence.
    assert known.log_odds.isfinite().tolist() == [False, True, True]
    assert known.log_odds[1] == known.log_odds[2]
    outside = known.state[1, :, 0] > 70
    assert 0 < outside.sum() < 200
    assert torch.equal(known.log_weight[1].isneginf(), outside)
    torch.testing.assert_close(known.log_weight[1].exp().sum(), torch.ones((), dtype=F64))


def test_limits_of_the_priors_are_in_units_of_the_data(snapshots):
    recording = validate(snapshots=1e-3 * snapshots, step_s=1.0)
    found = make_tracker(power_max=1e-5, noise_max=2e-8).prepare(recording)
    square = found.scale[:, None].square()
    torch.testing.assert_close(found.priors.power_max * square, torch.full((2, 2), 1e-5, dtype=F64))
    torch.testing.assert_close(found.priors.noise_max * square, torch.full((2, 2), 2e-8, dtype=F64))
    free = make_tracker().prepare(recording).priors
    torch.testing.assert_close(free, data_priors(found.measurement))


def test_powers_that_are_no_gamma_chain_are_refused():
    class OtherPower:
        def on(self, region):
            return self

    expected = "key 'model': found OtherPower and WhiteNoise, expected Gamma chains"
    with pytest.raises(InputError, match=expected):
        make_tracker(model=Model(power=OtherPower()))
