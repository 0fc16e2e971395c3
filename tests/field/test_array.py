import logging
import math
from itertools import combinations

import numpy as np
import pytest
import torch
from oracles.devices import assert_kind

from torchdt.data.recording import validate
from torchdt.field import PlaneWaveField, SphericalWaveField
from torchdt.field.array import SensorArray, nearest_spacing, warn_of_aliasing
from torchdt.field.mismatch import MismatchedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.region import Coordinate, Region
from torchdt.run.track import track

F64 = torch.float64
SQUARE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]


def test_waves_equal_the_exponential():
    array = SensorArray([30.0, 70.0], SQUARE, 343.0, 3, 2, dtype=F64)
    path = torch.tensor([0.3, -2.0, 1000.7, 0.0], dtype=F64)
    expected = np.exp(2j * np.pi / 343.0 * np.array([30.0, 70.0])[:, None] * path.numpy())
    np.testing.assert_allclose(array.waves(path).numpy(), expected, atol=1e-11)


def test_single_precision_holds_large_phases():
    """At 2e6 radians float32 alone has an error of a tenth; the reduced phase one of 1e-6."""
    tones, path = [3e4, 1e5], torch.linspace(-1000, 1000, 4 * 50, dtype=F64).reshape(50, 4)
    single, double = (
        SensorArray(tones, SQUARE, 343.0, 3, 2, dtype=d).waves(path) for d in (torch.float32, F64)
    )
    assert (single - double).abs().max() < 2e-6
    naive = torch.polar(
        torch.ones(()), 2 * math.pi * path.float()[:, None] * torch.tensor(tones)[:, None] / 343.0
    )
    assert (naive - double).abs().max() > 1e-2


def test_a_change_of_type_leaves_places_exact():
    places = [[1e4 / 3, 0.0, 0.0], [0.0, 1 / 3, 0.0]]
    array = SensorArray([30.0], places, 343.0, 2, 1, dtype=F64).float()
    assert array._places.tolist() == places


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_no_tensor_is_left_on_another_device(dtype):
    """The meta device holds no numbers: whatever is not there is an error."""
    state = torch.empty(5, 4, 6, dtype=dtype, device="meta")
    cube = [*SQUARE, [0.0, 0.0, 1.0]]
    for field in (
        PlaneWaveField([30.0, 70.0], cube, 343.0, "direction_cosines", device="meta", dtype=dtype),
        PlaneWaveField([30.0, 70.0], cube, 343.0, "azimuth_elevation", dtype=dtype).to("meta"),
        SphericalWaveField([30.0, 70.0], cube, 343.0, device="meta", dtype=dtype),
    ):
        response = field(state)
        assert response.shape == (5, 4, 2, 5)
        assert_kind(response, dtype, "meta")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"freqs": []}, "'field.freqs': found []"),
        ({"freqs": [10.0, 0.0]}, "'field.freqs': found [10.0, 0.0], expected one positive"),
        ({"freqs": [math.nan]}, "'field.freqs': found [nan], expected finite"),
        ({"freqs": "low"}, "'field.freqs': found low, expected an array"),
        ({"sensor_positions": [0.0, 1.0]}, "'field.sensor_positions': found shape (2,)"),
        ({"sensor_positions": [[0.0, 1.0]] * 3}, "'field.sensor_positions': found shape (3, 2)"),
        ({"sensor_positions": []}, "'field.sensor_positions': found shape (0,)"),
        ({"sensor_positions": [[0, 0, 0], [1, 0]]}, "'field.sensor_positions': found [[0, 0, 0], [1, 0]]"),
        ({"sensor_positions": [[m, 2 * m, 0] for m in range(4)]}, "found sensors that span 1 dim"),
        ({"sensor_positions": [[1, 1, 1]]}, "found sensors that span 0 dim"),
        ({"wave_speed": 0.0}, "'field.wave_speed': found 0.0"),
        ({"wave_speed": -math.inf}, "'field.wave_speed': found -inf"),
    ],
)
def test_wrong_input_is_named(change, words):
    arguments = {"freqs": [30.0], "sensor_positions": SQUARE, "wave_speed": 343.0} | change
    with pytest.raises(ValueError, match=r"^key 'field") as error:
        SensorArray(**arguments, space=3, min_rank=2)
    assert words in str(error.value)


def test_nearest_spacing_equals_the_loop():
    places = torch.rand(9, 3, generator=torch.Generator().manual_seed(0), dtype=F64)
    pairs = [math.dist(a, b) for a, b in combinations(places.tolist(), 2)]
    assert nearest_spacing(places) == pytest.approx(min(pairs))
    assert nearest_spacing(places[:1]) == math.inf


def test_spacing_beyond_half_a_wavelength_is_warned_of_once(caplog):
    places = torch.tensor(SQUARE, dtype=F64)
    with caplog.at_level(logging.WARNING):
        warn_of_aliasing(places, [171.5, 100.0], 343.0)  # exactly half of 2 m
        warn_of_aliasing(places[:1], [1e6], 343.0)
        assert caplog.text == ""
        for _ in range(3):
            warn_of_aliasing(places, [100.0, 172.25], 343.0)
    assert caplog.text.count("sensors are 1 m apart") == 1
    assert "0.9956 m at 172.2 Hz" in caplog.text


CUBE = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.1], [0.0, 0.25, 0.0], [-0.1, 0.2, 0.4], [0.0, 0.0, 0.2]]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("normalize", [True, False])
def test_a_diffuse_field_is_the_mean_over_all_directions(normalize, sign):
    """Of `a a^H`, by quadrature over the sphere: Gauss-Legendre in height, evenly spaced in azimuth."""
    field = PlaneWaveField(
        [400.0, 900.0], CUBE, 343.0, "azimuth_elevation", normalize=normalize, sign=sign, dtype=F64
    )
    height, weight = np.polynomial.legendre.leggauss(40)
    elevation, azimuth = np.degrees(np.arcsin(height)), np.arange(80) * 4.5
    states = torch.from_numpy(np.stack(np.meshgrid(azimuth, elevation), -1))  # (40, 80, 2)
    response = field(states)
    each = response[..., :, None] * response[..., None, :].conj()
    expected = (each.mean(1) * torch.from_numpy(weight / 2)[:, None, None, None]).sum(0)
    found = field.incoherent(states)
    assert found.shape == (40, 80, 2, 5, 5)
    torch.testing.assert_close(found, expected.expand_as(found), rtol=0, atol=1e-10)


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_a_diffuse_field_has_the_energy_of_the_response(normalize, dtype):
    spherical = SphericalWaveField([400.0, 900.0], CUBE, 343.0, normalize=normalize, dtype=dtype)
    plane = PlaneWaveField([400.0, 900.0], CUBE, 343.0, "bearing", normalize=normalize, dtype=dtype)
    for field, state in ((spherical, [[[2.0, 1.0], [-0.5, 3.0]]]), (plane, [[[10.0], [200.0]]])):
        states = torch.tensor(state, dtype=dtype)
        found = field.incoherent(states)
        assert_kind(found, torch.complex(states, states).dtype, "cpu")
        trace = found.diagonal(dim1=-2, dim2=-1).real.sum(-1)
        torch.testing.assert_close(trace, field(states).abs().square().sum(-1))
        torch.testing.assert_close(field.incoherent(states[0, 1]), found[0, 1])
        assert torch.linalg.eigvalsh(found).min() > -1e-6


def test_a_diffuse_field_is_white_where_sensors_are_half_a_wavelength_apart():
    """The sine is zero at multiples of half a wavelength."""
    line = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.5, 0.0, 0.0]]
    field = SphericalWaveField([343.0], line, 343.0, dtype=F64)
    found = field.incoherent(torch.tensor([3.0, 4.0], dtype=F64))
    torch.testing.assert_close(found[0].real, torch.eye(3, dtype=F64) / 3)


def test_a_diffuse_share_acts_in_the_tracker():
    """One loud source in a room, half of its energy diffuse: with the share it is the only object."""
    stream = torch.Generator().manual_seed(0)
    places = [[0.06 * x, 0.06 * y, 0.0] for x in range(3) for y in range(2)]
    field = PlaneWaveField([1500.0, 2500.0], places, 343.0, "bearing", dtype=F64)
    share = torch.full((2,), 0.5, dtype=F64)
    room = MismatchedField(field, share)
    state = torch.tensor([40.0, 0.0], dtype=F64)
    coherent = room(state)
    covariance = coherent[:, :, None] * coherent[:, None].conj() + room.diffuse(state)
    lower = torch.linalg.cholesky(covariance + 1e-4 * torch.eye(6, dtype=covariance.dtype))
    draws = torch.randn(20, 2, 6, 10, generator=stream, dtype=torch.complex128)
    coordinate = Coordinate("bearing", "deg", -180, 180, 10, -1, 1, 1e-3, period=360)
    config = TrackerConfig(particles=100, mismatch_share=share.tolist())
    tracker = DirectTracker(field, Region([coordinate], F64), 1.0, config)
    history = track(validate(snapshots=(lower @ draws).mT, step_s=1.0), tracker, seeds=[0])
    assert history.declared[0, 5:].sum(-1).eq(1).all()
    assert (history.position[0, 5:][history.declared[0, 5:]] - 40).abs().max() < 10
