"""Fields of one's own, and fields around fields: nothing need be known, and nothing known gets lost."""

import math

import pytest
import torch
from oracles.line_array import FREQS, POSITIONS, SMALL, make_region, simulate
from oracles.waveguide import make_field as make_waveguide
from oracles.waveguide import make_region as make_water
from torch import Tensor

from torchdt.baselines.detect.config import PursuitConfig, SblConfig
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import InputError
from torchdt.data.recording import validate
from torchdt.field import LineArrayField, PlaneWaveField
from torchdt.field.base import as_field, repeat_field
from torchdt.field.mismatch import MismatchedField
from torchdt.field.stacked import StackedField
from torchdt.field.wrapped import CompletedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.region import Coordinate, Region
from torchdt.run.track import track

F64 = torch.float64
GROUND = [[x, y, 0.0] for x in (0.0, 0.1, 0.2) for y in (0.0, 0.1, 0.2)]
SKY = Region([Coordinate(name, "cos", -1, 1, 0.1, -0.1, 0.1, 1e-6) for name in ("east", "north")], F64)
SPEEDS = (1500.0, 1400.0, 1600.0)


class OwnLines:
    """A line array for each sequence, with a wave speed of its own; inherits nothing."""

    num_tones, num_sensors, num_coordinates = 2, 8, 1

    def __init__(self, speeds: tuple[float, ...]):
        self.num_sequences, self.speeds = len(speeds), speeds

    def __call__(self, state: Tensor) -> Tensor:
        sine = torch.sin(torch.deg2rad(state[..., 0]))[..., None, None]
        speed = torch.tensor(self.speeds, dtype=F64).reshape(-1, *[1] * (sine.ndim - 1))
        cycles = sine / speed * torch.tensor(FREQS, dtype=F64)[:, None] * torch.tensor(POSITIONS, dtype=F64)
        return torch.polar(torch.full_like(cycles, 8**-0.5), 2 * math.pi * cycles)

    def select(self, sequences) -> "OwnLines":
        chosen = range(len(self.speeds))[sequences] if isinstance(sequences, slice) else sequences
        return OwnLines(tuple(self.speeds[b] for b in chosen))


class Doppler:
    """A line array whose upper tone also turns by the rate: 90 degrees along it at a degree per second."""

    num_tones, num_sensors, num_coordinates = 2, 8, 1

    def __call__(self, state: Tensor) -> Tensor:
        _, rate = state.unbind(-1)  # an error where there is no rate
        response = LineArrayField(FREQS, POSITIONS, dtype=F64)(state)
        turn = math.pi / 2 / 7 * rate[..., None] * torch.arange(8, dtype=F64)
        turns = torch.stack([torch.zeros_like(turn), turn], -2)
        return response * torch.polar(torch.ones_like(turns), turns)


@pytest.fixture(scope="module")
def sky() -> PlaneWaveField:
    return PlaneWaveField([1000.0], GROUND, 343.0, "direction_cosines", dtype=F64)


def test_wrappers_keep_where_objects_can_be(sky):
    """350 of 400 cells reach into the unit circle, but for those that touch it by rounding."""
    share = torch.full((1,), 0.1, dtype=F64)
    stacked = StackedField([sky, MismatchedField(sky, share)])
    around = [sky, MismatchedField(sky, share), stacked, MismatchedField(stacked, share), as_field(stacked)]
    for field in (*around, CompletedField(stacked, SKY.complete), repeat_field(stacked, 2)):
        region = SKY.within(field)
        assert region.num_cells == 350
        state = torch.tensor([[0.9, 0.9, 0.0, 0.0], [0.3, 0.2, 0.0, 0.0]], dtype=F64)
        if field.num_sequences is not None:
            state = state.expand(field.num_sequences, 2, 4)
        expected = torch.tensor([False, True]).expand(state.shape[:-1])
        assert torch.equal(region.contains(state), expected)


def test_a_tracker_of_stacked_fields_looks_where_objects_can_be(sky):
    config = TrackerConfig(**SMALL)
    alone, stacked = (DirectTracker(f, SKY, 1.0, config) for f in (sky, StackedField([sky] * 3)))
    for tracker in (stacked, stacked.select(slice(1, 3)), TwoStepTracker(sky, SKY, 1.0, TwoStepConfig())):
        assert tracker.region.num_cells == 350
        heard = tracker.dictionary.energy.reshape(-1, 1, 400) > 0
        assert torch.equal(heard, (alone.dictionary.energy > 0).expand_as(heard))
    part = stacked.select(slice(1, 3))
    assert part.region.contains(torch.zeros(2, 5, 4, dtype=F64)).all()


def test_sequences_must_agree_on_where_objects_can_be(sky):
    """Each has as many particles and births as the others, in cells of one dictionary."""
    eastern = MismatchedField(sky, torch.zeros(1, dtype=F64))
    eastern.inside = lambda state: state[..., 0] > 0
    with pytest.raises(InputError, match="'fields': found different cells where objects can be"):
        SKY.within(StackedField([sky, eastern]))


def make_recording(num: int = 3, steps: int = 4):
    path = ((0.0, -30.0), (20.0, -20.0))
    snapshots = torch.stack([simulate(seed, path, steps=steps)[0] for seed in range(num)])
    return validate(snapshots=snapshots, step_s=1.0)


def test_an_own_field_for_each_sequence_is_cut_into_chunks():
    """With `num_sequences` and `select`, nothing inherited: the same as the fields of the package stacked."""
    own, stacked = (
        DirectTracker(field, make_region(), 1.0, TrackerConfig(**SMALL))
        for field in (
            OwnLines(SPEEDS),
            StackedField([LineArrayField(FREQS, POSITIONS, c, dtype=F64) for c in SPEEDS]),
        )
    )
    recording = make_recording()
    found, expected = (track(recording, t, [1, 2, 3], memory_gb=1e-9) for t in (own, stacked))
    assert torch.equal(found.declared, expected.declared)
    there = expected.existence > 0.1
    torch.testing.assert_close(found.state[there], expected.state[there], rtol=1e-5, atol=1e-5)
    assert own.dictionary.response.shape == (3, 2, 70, 8)


@pytest.mark.parametrize("detector", [None, PursuitConfig(points=2), SblConfig(points=2)])
def test_responses_may_depend_on_rates(detector):
    """Searches that know positions alone look at the middle of the region's rates. The bearing rises by half
    a degree in each step, which the response tells as well as the motion does."""
    field, region = Doppler(), make_region()
    state = torch.stack([torch.arange(6.0, dtype=F64) * 0.5 - 30, torch.full((6,), 0.5, dtype=F64)], -1)
    rng = torch.Generator().manual_seed(0)
    rho, noise = (torch.randn(6, 2, 3, n, dtype=torch.complex128, generator=rng) for n in (1, 8))
    snapshots = rho * field(state)[:, :, None] + 0.03 * noise
    if detector is None:
        tracker = DirectTracker(field, region, 1.0, TrackerConfig(**SMALL))
    else:
        tracker = TwoStepTracker(field, region, 1.0, TwoStepConfig(particles=200, detector=detector))
    history = track(validate(snapshots=snapshots, step_s=1.0), tracker, seeds=[0])
    declared = history.declared[0, -1]
    assert declared.sum() == 1
    bearing, rate = history.state[0, -1][declared][0]
    tolerance = (0.5, 0.1) if detector is None else (4.0, 1.0)
    assert abs(bearing + 27.5) < tolerance[0]
    assert abs(rate - 0.5) < tolerance[1]


def test_a_configured_share_acts_in_python():
    field, region, share = make_waveguide(F64), make_water(F64), [0.1, 0.3]
    expected = MismatchedField(field, torch.tensor(share, dtype=F64))
    state = torch.tensor([[2900.0, 40.0, 0.0, 0.0], [2800.0, 60.0, 0.0, 0.0]], dtype=F64)
    for one in (field, StackedField([field] * 2)):
        tracker = DirectTracker(one, region, 1.0, TrackerConfig(**SMALL, mismatch_share=share))
        torch.testing.assert_close(tracker.field(state), expected(state))
        torch.testing.assert_close(tracker.field.diffuse(state), expected.diffuse(state))
        torch.testing.assert_close(
            tracker.select(slice(0, 1)).field.diffuse(state[:1]), expected.diffuse(state[:1])
        )


@pytest.mark.parametrize(
    ("field", "share", "words"),
    [
        (Doppler(), [0.1, 0.1], "does not know how its response scatters"),
        (make_waveguide(F64), [0.1], "2 numbers, one for each tone"),
        (
            MismatchedField(make_waveguide(F64), torch.full((2,), 0.1, dtype=F64)),
            [0.1, 0.1],
            "share of its own",
        ),
    ],
)
def test_a_share_that_cannot_act_is_refused(field, share, words):
    region = make_region() if field.num_coordinates == 1 else make_water(F64)
    with pytest.raises(InputError, match=f"'tracker.mismatch_share': found .*{words}"):
        DirectTracker(field, region, 1.0, TrackerConfig(mismatch_share=share))


@pytest.mark.parametrize(
    ("kind", "key"),
    [(TrackerConfig, "tracker.mismatch_share"), (ConstantVelocity, "model.motion.driving_variance")],
)
@pytest.mark.parametrize("value", [0.1, ["much"], [math.nan], [-0.1]])
def test_lists_are_lists_of_numbers(kind, key, value):
    with pytest.raises(InputError, match=f"'{key}.*': found"):
        kind(**{key.rpartition(".")[2]: value})


def test_what_is_no_field_is_refused():
    field = OwnLines(SPEEDS)
    field.num_tones = 0
    for wrong, words in ((field, "'field.num_tones': found 0"), (object(), "'field': found object")):
        with pytest.raises(InputError, match=words):
            DirectTracker(wrong, make_region(), 1.0, TrackerConfig())


def test_fields_of_a_stack_must_fit_each_other():
    with pytest.raises(InputError, match="'fields': found none"):
        StackedField([])
    with pytest.raises(InputError, match=r"'fields': found .*the same tones"):
        StackedField([LineArrayField(FREQS, POSITIONS), LineArrayField(FREQS, POSITIONS[:5])])
