import math

import numpy as np
import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.field import Field, PlaneWaveField, SphericalWaveField
from torchdt.field.spherical_wave import MIN_DISTANCE

F64 = torch.float64
FREQS = (300.0, 900.0)
PLACES = [[0.0, 0.0, 0.0], [1.0, 0.2, 0.5], [-0.4, 2.0, 0.1], [1.5, 1.5, -0.3]]
STATES = torch.tensor([[3.0, 2.0, 1.0, 0.1, 0.0, 0.0], [-1.0, 0.5, 2.0, 0.0, 0.0, 0.0]], dtype=F64)


def make_field(places=PLACES, dtype=F64, **changes):
    return SphericalWaveField(FREQS, places, 343.0, **{"num_coordinates": 3, "dtype": dtype} | changes)


def test_equals_the_equation():
    field = make_field(normalize=False)
    assert isinstance(field, Field)
    assert (field.num_tones, field.num_sensors, field.num_coordinates) == (2, 4, 3)
    distance = np.linalg.norm(STATES[:, None, :3].numpy() - np.array(PLACES), axis=-1)[:, None]
    k = 2 * np.pi * np.array(FREQS)[:, None] / 343.0
    np.testing.assert_allclose(field(STATES).numpy(), np.exp(-1j * k * distance) / distance, atol=1e-12)


def test_two_coordinates_are_three_in_a_plane():
    space, plane = make_field(), make_field(num_coordinates=2, plane_z=1.0)
    torch.testing.assert_close(plane(STATES[:1, [0, 1, 3, 4]]), space(STATES[:1]))


def test_batches_norm_and_type():
    field, state = make_field(dtype=torch.float32), STATES.float().expand(3, 2, -1)
    response = field(state)
    assert response.shape == (3, 2, 2, 4)
    assert response.dtype == torch.complex64
    torch.testing.assert_close(response[1, 1], field(state[1, 1]))
    torch.testing.assert_close(torch.linalg.vector_norm(response, dim=-1), torch.ones(3, 2, 2))


def test_far_away_it_is_a_plane_wave():
    """At 2 km the wavefront of a 2 m array bends by less than a millimetre: 0.02 rad at 900 Hz."""
    plane = PlaneWaveField(FREQS, PLACES, 343.0, "azimuth_elevation", dtype=F64)
    for azimuth, elevation in ((20.0, 10.0), (-100.0, 50.0), (180.0, 0.0)):
        a = plane(torch.tensor([azimuth, elevation], dtype=F64))
        level = math.cos(math.radians(elevation))
        east, north = (level * f(math.radians(azimuth)) for f in (math.sin, math.cos))
        towards = torch.tensor([east, north, math.sin(math.radians(elevation))], dtype=F64)
        b = make_field()(2000 * towards)
        match = (a.conj() * b).sum(-1).abs()
        torch.testing.assert_close(match, torch.ones_like(match), rtol=0, atol=4e-4)
        near = (a.conj() * make_field()(3 * towards)).sum(-1).abs()
        assert (near < 0.99).any()


def test_moving_everything_changes_nothing():
    shift = [30.0, -7.0, 2.0]
    moved, state = (np.array(PLACES) + shift).tolist(), STATES.clone()
    state[:, :3] += torch.tensor(shift, dtype=F64)
    torch.testing.assert_close(make_field(moved)(state), make_field()(STATES))


def test_turning_everything_changes_nothing():
    turn = torch.linalg.qr(torch.rand(3, 3, generator=torch.Generator().manual_seed(2), dtype=F64)).Q
    state = torch.cat([STATES[:, :3] @ turn, STATES[:, 3:]], -1)
    turned = (torch.tensor(PLACES, dtype=F64) @ turn).tolist()
    torch.testing.assert_close(make_field(turned)(state), make_field()(STATES))


@pytest.mark.parametrize("normalize", [True, False])
def test_gradcheck(normalize):
    field = make_field(normalize=normalize)
    assert torch.autograd.gradcheck(field, (STATES.clone().requires_grad_(),))


@pytest.mark.parametrize("normalize", [True, False])
def test_at_a_sensor_values_and_gradients_are_finite(normalize):
    state = torch.tensor([PLACES[1], PLACES[1]], requires_grad=True)
    response = make_field(normalize=normalize, dtype=torch.float32)(state)
    assert response[0, 0, 1].abs().item() == pytest.approx(1.0 if normalize else 1 / MIN_DISTANCE, rel=1e-4)
    (gradient,) = torch.autograd.grad(response.real.sum(), state)
    assert gradient.isfinite().all()


def test_single_precision_holds_large_phases():
    """40 km away at 100 kHz: 7e7 radians. The states are exact in both types."""
    state = 4e4 + torch.arange(32.0)[:, None] * torch.tensor([1.0, -2.0, 3.0])
    single, double = (
        SphericalWaveField([1e5], PLACES, 343.0, num_coordinates=3, dtype=d)(state.to(d))
        for d in (torch.float32, F64)
    )
    assert (single - double).abs().max() < 2e-6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"num_coordinates": 1}, "'field.num_coordinates': found 1, expected 2 or 3"),
        ({"places": [[0, 0, 0], [1, 1, 1]]}, "span 1 dimensions, expected 2"),
        ({"places": [[0, 0, z] for z in range(4)], "num_coordinates": 2}, "span 0 horizontal dimensions"),
        ({"plane_z": math.nan}, "'field.plane_z': found nan"),
        ({"sign": 0}, "'field.sign': found 0, expected 1 or -1"),
        ({"places": [[0, 0], [1, 1]]}, "'field.sensor_positions': found shape (2, 2)"),
    ],
)
def test_wrong_input_is_named(change, words):
    with pytest.raises(InputError) as error:
        make_field(**change)
    assert words in str(error.value)


@pytest.mark.parametrize("state", [torch.zeros(2, dtype=F64), torch.zeros(3)])
def test_wrong_state_is_named(state):
    with pytest.raises(ValueError, match="state has shape"):
        make_field()(state)
