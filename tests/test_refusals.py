"""What does not fit together is refused wherever a tracker is built, in Python as in the configuration."""

import math

import pytest
import torch
from oracles.line_array import BEARING, FREQS, POSITIONS, make_field, make_region, simulate
from oracles.waveguide import make_field as make_waveguide

from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import InputError
from torchdt.data.recording import validate
from torchdt.field import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.model.region import Coordinate, Region
from torchdt.run.track import track

pytestmark = pytest.mark.slow
F64 = torch.float64
CONFIGS = {DirectTracker: TrackerConfig(slots=2, particles=10), TwoStepTracker: TwoStepConfig(slots=2)}
TRACKERS = pytest.mark.parametrize("kind", CONFIGS)


@TRACKERS
@pytest.mark.parametrize("number", [1, 2, 3])
def test_region_and_field_have_the_same_coordinates(kind, number):
    names = ("x", "y", "z")[:number]
    region = Region([Coordinate(**BEARING | {"name": name}) for name in names], F64)
    field = make_field() if number != 1 else make_waveguide(F64)
    expected = f"'scenario.coordinates': found {number} coordinates, expected {field.num_coordinates}"
    with pytest.raises(InputError, match=expected):
        kind(field, region, 1.0, CONFIGS[kind])


@TRACKERS
@pytest.mark.parametrize("step_s", [0.0, -1.0, math.nan, math.inf, None, True])
def test_a_step_takes_time(kind, step_s):
    with pytest.raises(InputError, match=r"'step_s': found .*, expected a positive number of seconds"):
        kind(make_field(), make_region(), step_s, CONFIGS[kind])


@TRACKERS
@pytest.mark.parametrize(("step_s", "fits"), [(2.0, False), (1.001, False), (1 + 1e-9, True)])
def test_a_step_is_that_of_the_recording(kind, step_s, fits):
    snapshots, _ = simulate(0, ((0.0, 10.0), (20.0, 15.0)), steps=2)
    recording, tracker = (
        validate(snapshots=snapshots, step_s=1.0),
        kind(make_field(), make_region(), step_s, CONFIGS[kind]),
    )
    if fits:
        assert track(recording, tracker, [0]).existence.shape[1] == 2
    else:
        with pytest.raises(InputError, match=f"'step_s': found {step_s} s in the tracker, expected 1.0 s"):
            track(recording, tracker, [0])


@TRACKERS
@pytest.mark.parametrize("number", [2, 4])
def test_a_field_for_each_sequence_is_of_those_of_the_recording(kind, number):
    snapshots = simulate(0, ((0.0, 10.0),), steps=2)[0].expand(3, -1, -1, -1, -1)
    tracker = kind(StackedField([make_field()] * number), make_region(), 1.0, CONFIGS[kind])
    with pytest.raises(InputError, match=f"'field': found fields of {number} sequences, expected 3"):
        track(validate(snapshots=snapshots, step_s=1.0), tracker, [0, 1, 2])


def test_a_region_has_a_coordinate():
    with pytest.raises(InputError, match=r"'scenario.coordinates': found none"):
        Region([])


class Returning:
    """A field that returns what it is told to."""

    num_tones, num_sensors, num_coordinates = 2, 8, 1

    def __init__(self, change):
        self.change = change

    def __call__(self, state):
        return self.change(LineArrayField(FREQS, POSITIONS, dtype=F64)(state))


def spoiled(value: float, where: int):
    def change(response: torch.Tensor) -> torch.Tensor:
        response[where, 1, 3] = value
        return response

    return change


@TRACKERS
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: a.mT, r"shape \(70, 8, 2\) and type .*expected shape \(70, 2, 8\)"),
        (lambda a: a[:, :1], r"shape \(70, 1, 8\)"),
        (lambda a: a.real, r"type torch.float64, expected .* type torch.complex128"),
        (lambda a: a.to(torch.complex64), r"type torch.complex64, expected .* type torch.complex128"),
        (lambda a: a.numpy(), "a response of ndarray"),
        (spoiled(math.nan, 10), r"not finite in 1 cells, the first at {'bearing': -49.0}"),
        (spoiled(math.inf, 69), r"not finite in 1 cells, the first at {'bearing': 69.0}"),
    ],
)
def test_what_a_field_returns_is_checked(kind, change, words):
    tracker = kind(Returning(change), make_region(), 1.0, CONFIGS[kind])
    with pytest.raises(InputError, match=f"'field': found .*{words}"):
        _ = tracker.dictionary


def test_where_no_object_can_be_a_response_need_not_be_finite():
    region = Region([Coordinate(**BEARING)], F64, inside=lambda state: state[..., 0] > -40)
    found = build_dictionary(Returning(spoiled(math.nan, 10)), region)
    assert found.response.isfinite().all()
