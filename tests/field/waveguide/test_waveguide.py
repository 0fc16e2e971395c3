import math

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline

from torchdt.field import Environment, Field, HalfSpace, NormalModeField, solve_modes
from torchdt.field.waveguide.waveguide import _CHUNK_CPU, MIN_DEPTH, MIN_RANGE

DOUBLE = torch.float64
TILT = 2.0


@pytest.fixture(scope="module")
def field(swellex, tones, sensors):
    return NormalModeField(swellex, tones, sensors, TILT)


@pytest.fixture(scope="module")
def exact(swellex, tones, sensors):
    return NormalModeField(swellex, tones, sensors, TILT, dtype=DOUBLE)


@pytest.fixture
def states():
    generator = torch.Generator().manual_seed(4)
    unit = torch.rand(64, 4, generator=generator)
    return unit * torch.tensor([4500.0, 200.0, 1.0, 1.0]) + torch.tensor([500.0, 5.0, 0.0, 0.0])


def direct_sum(environment, frequency, sensors, tilt, distance, depth, bow=0.0):
    """The mode sum with every sensor at its own range, on a mesh four times as fine, by splines."""
    table = solve_modes(environment, frequency, points_per_wavelength=64.0, grid_step=0.1)
    spline = CubicSpline(table.depth, table.psi)
    sensors = np.array(sensors)
    ranges = distance - (sensors.max() - sensors) * math.tan(math.radians(tilt))
    half = np.ptp(sensors) / 2  # a parabola that leaves the ends where they are
    ranges -= bow * (1 - ((sensors - sensors.max() + half) / half) ** 2)
    k = table.wavenumber - 1j * table.attenuation
    terms = spline(depth) * spline(sensors) * np.exp(-1j * k * ranges[:, None])
    return (terms / np.sqrt(table.wavenumber * distance)).sum(-1)


@pytest.mark.parametrize("tilt", [0.0, TILT, -1.0])
@pytest.mark.parametrize("position", [(5000.0, 54.3), (1567.0, 9.13), (3001.7, 200.2)])
def test_equals_the_direct_sum(swellex, tones, sensors, tilt, position):
    field = NormalModeField(swellex, tones, sensors, tilt, normalize=False, dtype=DOUBLE)
    response = field(torch.tensor(position, dtype=DOUBLE)).numpy()
    for i, f in enumerate(tones):
        expected = direct_sum(swellex, f, sensors, tilt, *position)
        assert np.linalg.norm(response[i] - expected) < 3e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("bow", [2.5, -1.0])
def test_a_bowed_array(swellex, tones, sensors, bow):
    field = NormalModeField(swellex, tones, sensors, TILT, bow=bow, normalize=False, dtype=DOUBLE)
    response = field(torch.tensor([3001.7, 58.0], dtype=DOUBLE)).numpy()
    for i, f in enumerate(tones):
        expected = direct_sum(swellex, f, sensors, TILT, 3001.7, 58.0, bow)
        assert np.linalg.norm(response[i] - expected) < 3e-3 * np.linalg.norm(expected)


def test_one_sensor_has_no_bow(swellex, tones):
    one, bent = (NormalModeField(swellex, tones, [50.0], bow=bow, dtype=DOUBLE) for bow in (0.0, 2.0))
    state = torch.tensor([3001.7, 58.0], dtype=DOUBLE)
    assert torch.equal(one(state), bent(state))
    with pytest.raises(ValueError, match="bow is inf; expected a finite number"):
        NormalModeField(swellex, tones, [50.0], bow=math.inf)


def test_normalisation_changes_only_the_norm(swellex, tones, sensors, exact, states):
    states = states.double()
    raw = NormalModeField(swellex, tones, sensors, TILT, normalize=False, dtype=DOUBLE)(states)
    response = exact(states)
    norm = torch.linalg.vector_norm(response, dim=-1)
    torch.testing.assert_close(norm, torch.ones_like(norm))
    torch.testing.assert_close(response, raw / torch.linalg.vector_norm(raw, dim=-1, keepdim=True))


def test_reciprocity(swellex):
    upper, lower = 31.4, 172.0
    responses = [
        NormalModeField(swellex, (148.0, 388.0), (receiver,), normalize=False, dtype=DOUBLE)(
            torch.tensor([2345.0, source], dtype=DOUBLE)
        )
        for source, receiver in ((upper, lower), (lower, upper))
    ]
    torch.testing.assert_close(responses[0], responses[1], rtol=1e-9, atol=0.0)


def test_gradcheck(exact):
    # Depths inside grid cells and close to the surface and the seafloor.
    position = [[5000.0, 54.3], [1600.0, 0.7], [2500.3, 216.2], [900.0, 120.11]]
    state = torch.tensor(position, dtype=DOUBLE, requires_grad=True)
    assert torch.autograd.gradcheck(exact, (state,), atol=1e-6)


def test_slope_is_continuous_across_grid_nodes(exact, swellex):
    node = float(solve_modes(swellex, 388.0).depth[160])
    slopes = []
    for depth in (node - 1e-7, node + 1e-7):
        state = torch.tensor([3000.0, depth], dtype=DOUBLE, requires_grad=True)
        exact(state).real.sum().backward()
        slopes.append(state.grad)
    torch.testing.assert_close(slopes[0], slopes[1], rtol=1e-5, atol=1e-8)


def test_gradient_in_the_tilt(swellex, sensors):
    tilt = torch.tensor(1.3, dtype=DOUBLE, requires_grad=True)
    state = torch.tensor([3000.0, 60.0], dtype=DOUBLE)

    def respond(angle):
        return NormalModeField(swellex, (112.0, 388.0), sensors, angle, dtype=DOUBLE)(state)

    assert torch.autograd.gradcheck(respond, (tilt,))
    torch.testing.assert_close(respond(tilt), respond(1.3))


def test_tilt_can_be_a_parameter(swellex, sensors, states):
    field = NormalModeField(swellex, (112.0,), sensors, torch.nn.Parameter(torch.tensor(1.0)))
    assert [name for name, _ in field.named_parameters()] == ["tilt"]
    before = field(states)
    with torch.no_grad():
        field.tilt += 1.0
    torch.testing.assert_close(field(states), NormalModeField(swellex, (112.0,), sensors, 2.0)(states))
    assert not torch.allclose(field(states), before)


def test_single_precision_agrees_with_double(field, exact, states):
    states[:, 0] += 4000.0
    response = field(states)
    assert response.dtype == torch.complex64
    torch.testing.assert_close(response.to(torch.complex128), exact(states.double()), rtol=0.0, atol=1e-4)


def test_change_of_type_keeps_the_phases_exact(swellex, tones, sensors, field, states):
    changed = NormalModeField(swellex, tones, sensors, TILT, dtype=DOUBLE).float()
    torch.testing.assert_close(changed(states), field(states), rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("batch", [(), (0,), (3,), (2, 3), (_CHUNK_CPU + 7,)])
def test_shapes_and_batches(field, states, batch):
    count = math.prod(batch)
    state = states[torch.arange(count) % len(states)].reshape(*batch, 4)
    response = field(state)
    assert response.shape == (*batch, 7, 21)
    for index in (0, count - 1)[:count]:
        single = field(state.reshape(-1, 4)[index, :2])
        torch.testing.assert_close(response.reshape(-1, 7, 21)[index], single, rtol=1e-4, atol=1e-5)


def test_is_a_field(field):
    assert isinstance(field, Field)
    assert (field.num_tones, field.num_sensors, field.num_coordinates) == (7, 21, 2)


@pytest.mark.parametrize("normalize", [True, False])
def test_finite_outside_the_region(swellex, tones, sensors, normalize):
    field = NormalModeField(swellex, tones, sensors, TILT, normalize=normalize)
    ranges = torch.tensor([-100.0, 0.0, MIN_RANGE, 2000.0, 1e6, 1e8])
    depths = torch.tensor([-5.0, 0.0, MIN_DEPTH, 100.0, 216.5, 300.0])
    state = torch.cartesian_prod(ranges, depths).requires_grad_()
    response = field(state)
    assert response.isfinite().all()
    response.abs().sum().backward()
    assert state.grad.isfinite().all()
    outside = (state[:, 1] < 0) | (state[:, 1] > 216.5)
    assert (state.grad[outside, 1] == 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_sensor_at_the_surface_hears_nothing(swellex, dtype):
    state = torch.tensor([[2000.0, 50.0], [3000.0, 0.0]], dtype=dtype, requires_grad=True)
    for depths in ((0.0, 50.0, 100.0), (0.0,)):
        response = NormalModeField(swellex, (49.0, 112.0), depths, dtype=dtype)(state)
        assert (response[..., 0] == 0).all()
        norm = torch.linalg.vector_norm(response, dim=-1)
        torch.testing.assert_close(norm, torch.full_like(norm, float(len(depths) > 1)))
        (slope,) = torch.autograd.grad(response.abs().square().sum() + response.real.sum(), state)
        assert slope.isfinite().all()


def test_other_environment_gives_another_field(swellex, tones, sensors, field, states):
    changed = NormalModeField(swellex.perturbed(water_depth=218.0), tones, sensors, TILT)
    overlap = (changed(states).conj() * field(states)).sum(-1).abs()
    assert overlap.mean() < 0.9


@pytest.mark.parametrize(
    ("freqs", "depths", "message"),
    [
        ((), (50.0,), "freqs is"),
        ((100.0,), (), "sensor_depths is"),
        ((100.0,), (50.0, 101.0), "sensor_depths is.*100"),
        ((100.0,), (-0.1,), "sensor_depths is"),
        ((-100.0,), (50.0,), "freqs is.*-100"),
        ((math.nan,), (50.0,), "freqs is.*nan"),
        ((100.0,), (50.0, math.nan), "sensor_depths is.*nan"),
    ],
)
def test_wrong_input_is_named(freqs, depths, message):
    environment = Environment(((0.0, 1500.0), (100.0, 1500.0)), (), HalfSpace(1800.0, 2.0, 0.1))
    with pytest.raises(ValueError, match=message):
        NormalModeField(environment, freqs, depths)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tilt": math.nan}, "tilt is nan"),
        ({"max_phase_speed": math.nan}, "max_phase_speed is nan"),
        ({"sign": 2}, "'field.sign': found 2"),
    ],
)
def test_wrong_settings_are_named(change, message):
    environment = Environment(((0.0, 1500.0), (100.0, 1500.0)), (), HalfSpace(1800.0, 2.0, 0.1))
    with pytest.raises(ValueError, match=message):
        NormalModeField(environment, (100.0,), (50.0,), **change)


@pytest.mark.parametrize("state", [torch.zeros(3, 1), torch.tensor(1.0), torch.ones(4, dtype=DOUBLE)])
def test_wrong_state_is_named(field, state):
    with pytest.raises(ValueError, match="state has shape"):
        field(state)
