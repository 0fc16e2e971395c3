import math

import numpy as np
import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.field import Field, LineArrayField, PlaneWaveField

FREQS = (60.0, 200.0)
POSITIONS = (0.0, 2.5, 5.0, 11.0)


def test_equals_the_equation():
    field = LineArrayField(FREQS, POSITIONS, 1480.0, dtype=torch.float64)
    assert isinstance(field, Field)
    assert (field.num_tones, field.num_sensors, field.num_coordinates) == (2, 4, 1)
    response = field(torch.tensor([33.0, 0.1], dtype=torch.float64))
    for i, f in enumerate(FREQS):
        for m, x in enumerate(POSITIONS):
            angle = 2 * math.pi * f / 1480.0 * x * math.sin(math.radians(33.0))
            assert complex(response[i, m]) == pytest.approx(complex(math.cos(angle), math.sin(angle)) / 2)


def test_batch_equals_single_and_norm_is_one():
    field = LineArrayField(FREQS, POSITIONS)
    state = torch.rand(3, 5, 2) * 180 - 90
    response = field(state)
    assert response.shape == (3, 5, 2, 4)
    assert response.dtype == torch.complex64
    torch.testing.assert_close(response[1, 2], field(state[1, 2]))
    torch.testing.assert_close(torch.linalg.vector_norm(response, dim=-1), torch.ones(3, 5, 2))


def test_gradcheck():
    field = LineArrayField(FREQS, POSITIONS, dtype=torch.float64)
    state = torch.tensor([[-40.0, 0.2], [12.0, 0.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(field, (state,))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((), POSITIONS), "'field.freqs': found"),
        (((-1.0,), POSITIONS), "'field.freqs': found"),
        (((math.nan,), POSITIONS), "'field.freqs': found"),
        ((FREQS, ()), "'field.sensor_positions': found"),
        ((FREQS, (0.0, math.nan)), "'field.sensor_positions': found"),
        ((FREQS, (7.0,)), "sensors that span 0 horizontal dimensions, expected 1 or more"),
        ((FREQS, POSITIONS, 0.0), "'field.wave_speed': found 0"),
        ((FREQS, POSITIONS, math.nan), "'field.wave_speed': found nan"),
    ],
)
def test_wrong_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        LineArrayField(*arguments)


@pytest.mark.parametrize("state", [torch.tensor(1.0), torch.zeros(2, dtype=torch.float64)])
def test_wrong_state_is_named(state):
    with pytest.raises(ValueError, match="state has shape"):
        LineArrayField(FREQS, POSITIONS)(state)


F64 = torch.float64
PLACES = [[0.0, 0.0, 0.0], [2.0, 0.3, 0.1], [-1.0, 4.0, 2.0], [0.5, 3.0, -1.0], [6.0, -2.0, 0.4]]
STATES = {
    "direction_cosines": [[0.4, -0.3, 0.01, 0.0], [-0.1, 0.2, 0.0, 0.0]],
    "azimuth_elevation": [[130.0, 20.0, 1.0, 0.0], [-20.0, 75.0, 0.0, 0.0]],
    "bearing": [[70.0, 0.5], [-160.0, 0.0]],
}
VECTORS = {
    "direction_cosines": lambda e, n: [e, n, math.sqrt(1 - e * e - n * n)],
    "azimuth_elevation": lambda a, b: [
        math.cos(math.radians(b)) * math.sin(math.radians(a)),
        math.cos(math.radians(b)) * math.cos(math.radians(a)),
        math.sin(math.radians(b)),
    ],
    "bearing": lambda a: [math.sin(math.radians(a)), math.cos(math.radians(a)), 0.0],
}
KINDS = pytest.mark.parametrize("kind", STATES)


def rotated(places, degrees):
    """Places (M, 3) turned clockwise as seen from above."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (np.array(places) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])).tolist()


@KINDS
@pytest.mark.parametrize("sign", [1, -1])
def test_plane_wave_equals_the_equation(kind, sign):
    field = PlaneWaveField(FREQS, PLACES, 343.0, kind, sign=sign, normalize=False, dtype=F64)
    state = torch.tensor(STATES[kind], dtype=F64)
    u = np.array([VECTORS[kind](*row[: field.num_coordinates]) for row in STATES[kind]])
    path = u @ np.array(PLACES).T
    expected = np.exp(sign * 2j * np.pi / 343.0 * np.array(FREQS)[:, None] * path[:, None])
    np.testing.assert_allclose(field(state).numpy(), expected, atol=1e-12)


@KINDS
def test_plane_wave_batches_norm_and_type(kind):
    field = PlaneWaveField(FREQS, PLACES, 343.0, kind)
    state = torch.tensor(STATES[kind]).expand(3, 2, -1)
    response = field(state)
    assert response.shape == (3, 2, 2, 5)
    assert response.dtype == torch.complex64
    torch.testing.assert_close(response[1, 1], field(state[1, 1]))
    torch.testing.assert_close(torch.linalg.vector_norm(response, dim=-1), torch.ones(3, 2, 2))


@KINDS
def test_plane_wave_gradcheck(kind):
    field = PlaneWaveField(FREQS, PLACES, 343.0, kind, dtype=F64)
    assert torch.autograd.gradcheck(field, (torch.tensor(STATES[kind], dtype=F64, requires_grad=True),))


@KINDS
def test_moving_the_array_changes_a_common_phase_alone(kind):
    state = torch.tensor(STATES[kind], dtype=F64)
    moved = (np.array(PLACES) + np.array([3.0, -1.0, 7.0])).tolist()
    here, there = (PlaneWaveField(FREQS, p, 343.0, kind, dtype=F64)(state) for p in (PLACES, moved))
    turn = there / here
    torch.testing.assert_close(turn, turn[..., :1].expand_as(turn))
    assert (turn - 1).abs().min() > 1e-3


@pytest.mark.parametrize("kind", ["azimuth_elevation", "bearing"])
def test_turning_the_array_turns_the_azimuth(kind):
    state = torch.tensor(STATES[kind], dtype=F64)
    later = state.clone()
    later[:, 0] += 25.0
    here = PlaneWaveField(FREQS, PLACES, 343.0, kind, dtype=F64)(state)
    turned = PlaneWaveField(FREQS, rotated(PLACES, 25.0), 343.0, kind, dtype=F64)(later)
    torch.testing.assert_close(turned, here)


def test_line_to_the_east_is_the_line_array():
    """Whose bearing is from broadside: that from north, for sensors of which one is off the line."""
    line = LineArrayField(FREQS, POSITIONS, 343.0, dtype=F64)
    places = [[x, 0.0, 0.0] for x in POSITIONS]
    field = PlaneWaveField(FREQS, [*places, [0.0, 3.0, 0.0]], 343.0, "bearing", normalize=False, dtype=F64)
    state = torch.linspace(-90, 90, 13, dtype=F64)[:, None]
    torch.testing.assert_close(field(state)[..., :4] / 2, line(state))


def test_outside_the_unit_circle():
    field = PlaneWaveField(FREQS, PLACES, 343.0, "direction_cosines")
    state = torch.tensor([[0.6, 0.7], [0.8, 0.7], [3.0, 4.0], [-1.0, -1.0]], requires_grad=True)
    response = field(state)
    assert field.inside(state).tolist() == [True, False, False, False]
    torch.testing.assert_close(response[2], field(torch.tensor([0.6, 0.8])), rtol=0, atol=1e-2)
    (gradient,) = torch.autograd.grad(response.real.sum(), state)
    assert gradient.isfinite().all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"coordinates": "polar"}, "'field.coordinates': found polar, expected one of"),
        ({"sign": 2}, "'field.sign': found 2"),
        ({"freqs": [-1.0]}, "'field.freqs': found"),
        ({"sensor_positions": [[x, 0.0, 0.0] for x in POSITIONS]}, "span 1 dimensions, expected 2"),
    ],
)
def test_wrong_plane_wave_is_named(change, words):
    values = {
        "freqs": FREQS,
        "sensor_positions": PLACES,
        "wave_speed": 343.0,
        "coordinates": "direction_cosines",
    }
    with pytest.raises(InputError) as error:
        PlaneWaveField(**values | change)
    assert words in str(error.value)


@pytest.mark.parametrize("state", [torch.tensor(1.0), torch.zeros(1), torch.zeros(2, dtype=F64)])
def test_wrong_state_of_a_plane_wave_is_named(state):
    with pytest.raises(ValueError, match="state has shape"):
        PlaneWaveField(FREQS, PLACES, 343.0, "direction_cosines")(state)
