import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import brentq

from torchdt.field import Environment, HalfSpace, Layer, ModeSolverError, solve_modes
from torchdt.field.waveguide.modes import _build_mesh, _solve_mesh

DEPTH, SPEED, FREQ = 100.0, 1500.0, 200.0
OMEGA = 2 * np.pi * FREQ
NEAR = 503.0


def over(halfspace):
    return Environment(((0.0, SPEED), (DEPTH, SPEED)), (), halfspace)


def limited(k2, max_phase_speed):
    """Wavenumbers of the squared ones that stand for modes up to a phase speed."""
    return np.sqrt(k2[k2 > (OMEGA / max_phase_speed) ** 2])


@pytest.mark.parametrize(("density", "offset"), [(1e8, 0.5), (1e-8, 0.0)], ids=["rigid", "pressure release"])
def test_ideal_waveguide(density, offset):
    table = solve_modes(over(HalfSpace(6000.0, density, 0.0)), FREQ, max_phase_speed=3000.0)
    m = np.arange(1, 100)
    kz = (m - offset) * np.pi / DEPTH
    expected = limited((OMEGA / SPEED) ** 2 - kz**2, 3000.0)
    n = len(expected)
    assert len(table.wavenumber) == n > 10
    np.testing.assert_allclose(table.wavenumber, expected, atol=1e-5)
    finer = solve_modes(over(HalfSpace(6000.0, density, 0.0)), FREQ, 3000.0, points_per_wavelength=32.0)
    error, finer_error = (np.abs(t.wavenumber - expected).max() for t in (table, finer))
    assert 12 < error / finer_error < 20  # fourth order after extrapolation: 16
    sines = np.sqrt(2 / DEPTH) * np.sin(kz[:n] * table.depth[:, None])
    slopes = np.sqrt(2 / DEPTH) * kz[:n] * np.cos(kz[:n] * table.depth[:, None])
    sign = np.sign(np.sum(sines * table.psi, axis=0))
    np.testing.assert_allclose(sign * table.psi, sines, atol=1e-3 * sines.max())
    np.testing.assert_allclose(sign * table.slope, slopes, atol=3e-3 * slopes.max())


class Pekeris:
    """Characteristic equation `rho kz cos(kz D) + kappa sin(kz D) = 0` of water over a half-space."""

    speed, density, attenuation = 1800.0, 1.7, 0.03

    def __init__(self, lossy):
        # dB/(km Hz) to Np/m; the loss makes the wavenumber of the bottom complex.
        loss = self.attenuation * FREQ / 1000 / (20 * np.log10(np.e)) if lossy else 0.0
        self.k_bottom = OMEGA / self.speed + 1j * loss

    def __call__(self, k):
        kz = np.sqrt((OMEGA / SPEED) ** 2 - k**2 + 0j)
        kappa = np.sqrt(k**2 - self.k_bottom**2 + 0j)
        return self.density * kz * np.cos(kz * DEPTH) + kappa * np.sin(kz * DEPTH)

    def real_roots(self, max_phase_speed):
        grid = np.linspace(OMEGA / max_phase_speed, OMEGA / SPEED * (1 - 1e-9), 20001)
        values = self(grid).real
        cells = np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
        roots = [brentq(lambda k: self(k).real, grid[i], grid[i + 1], xtol=1e-14) for i in cells]
        return np.array(roots[::-1])

    def newton(self, k):
        for _ in range(50):
            slope = (self(k + 1e-7) - self(k - 1e-7)) / 2e-7
            k = k - self(k) / slope
        return k


def test_pekeris_wavenumbers_and_losses():
    bottom = HalfSpace(Pekeris.speed, Pekeris.density, Pekeris.attenuation)
    table = solve_modes(over(bottom), FREQ, max_phase_speed=1750.0)
    expected = Pekeris(lossy=False).real_roots(1750.0)
    assert len(table.wavenumber) == len(expected) > 10
    np.testing.assert_allclose(table.wavenumber, expected, atol=1e-6)
    complex_roots = Pekeris(lossy=True).newton(expected.astype(complex))
    # First-order perturbation: the rest is of the order of the squared loss.
    np.testing.assert_allclose(table.attenuation, complex_roots.imag, rtol=1e-3)
    assert table.attenuation.min() > 0


def test_layers_and_halfspace_are_one_medium_when_their_figures_agree():
    half = HalfSpace(Pekeris.speed, Pekeris.density, Pekeris.attenuation)
    layer = Layer(117.3, half.speed, half.speed, half.density, half.attenuation)
    split = Environment(((0.0, SPEED), (33.3, SPEED), (DEPTH, SPEED)), (layer,), half)
    one, two = solve_modes(over(half), FREQ), solve_modes(split, FREQ)
    np.testing.assert_allclose(two.wavenumber, one.wavenumber, atol=1e-6)
    np.testing.assert_allclose(two.attenuation, one.attenuation, rtol=1e-3)


def test_attenuation_per_wavelength_is_that_of_the_speed_at_each_depth():
    """A layer with a gradient against thin uniform ones, each with its own dB/(km Hz)."""
    half = HalfSpace(2600.0, 2.0, 0.3, "dB/wavelength")
    layer = Layer(180.0, 1550.0, 2500.0, 1.7, 0.5, "dB/wavelength")
    edges = np.linspace(DEPTH, 180.0, 161)
    speeds = 1550.0 + 950.0 * (edges - DEPTH) / 80.0
    middle = (speeds[1:] + speeds[:-1]) / 2
    thin = tuple(Layer(z, c, c, 1.7, 1000 * 0.5 / c) for z, c in zip(edges[1:], middle, strict=True))
    water = ((0.0, SPEED), (DEPTH, SPEED))
    graded = solve_modes(Environment(water, (layer,), half), FREQ)
    stack = solve_modes(Environment(water, thin, HalfSpace(2600.0, 2.0, 1000 * 0.3 / 2600.0)), FREQ)
    np.testing.assert_allclose(graded.wavenumber, stack.wavenumber, rtol=1e-5)
    np.testing.assert_allclose(graded.attenuation, stack.attenuation, rtol=2e-3)
    at_top = Environment(water, (Layer(180.0, 1550.0, 2500.0, 1.7, 1000 * 0.5 / 1550.0),), half)
    assert (solve_modes(at_top, FREQ).attenuation / stack.attenuation).max() > 1.05


class Stack:
    """Characteristic function of uniform layers over a half-space, from `psi` and `psi' / rho` going down."""

    def __init__(self, environment, frequency):
        self.omega, self.half = 2 * np.pi * frequency, environment.halfspace
        tops = np.concatenate([[0.0, environment.water_depth], [x.bottom for x in environment.layers]])
        speeds = [environment.profile[0][1], *(x.speed_top for x in environment.layers)]
        densities = [1.0, *(x.density for x in environment.layers)]
        self.layers = list(zip(np.diff(tops), speeds, densities, strict=True))

    def __call__(self, k):
        psi, flux, norm = np.zeros_like(k), np.ones_like(k), np.zeros_like(k)
        for thickness, speed, density in self.layers:
            kz = np.sqrt((self.omega / speed) ** 2 - k**2 + 0j)
            z = np.linspace(0.0, thickness, 801)[:, None]
            inside = (psi * np.cos(kz * z) + density * flux * np.sin(kz * z) / kz).real
            norm = norm + simpson(inside**2, x=z[:, 0], axis=0) / density
            flux = (flux * np.cos(kz * thickness) - psi * kz * np.sin(kz * thickness) / density).real
            psi = inside[-1]
        decay = np.sqrt(k**2 - (self.omega / self.half.speed) ** 2)
        return flux + decay * psi / self.half.density, norm + psi**2 / (2 * decay * self.half.density)

    def roots(self, max_phase_speed, num):
        grid = np.linspace(self.omega / max_phase_speed, self.omega / SPEED * (1 - 1e-9), num)
        values = np.concatenate([self(part)[0] for part in np.split(grid, 10)])
        cells = np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
        find = [brentq(lambda k: self(np.array([k]))[0][0], *grid[[i, i + 1]], xtol=1e-12) for i in cells]
        return np.array(find[::-1])


def test_modes_of_almost_the_same_wavenumber():
    """Modes of the water and of the sediment cross, and mix differently on every mesh."""
    layers = (Layer(83.26, 1600.0, 1600.0, 1.7, 0.1), Layer(183.26, 1750.0, 1750.0, 1.9, 0.1))
    environment = Environment(((0.0, SPEED), (75.76, SPEED)), layers, HalfSpace(2000.0, 2.0, 0.1))
    stack = Stack(environment, NEAR)
    expected = stack.roots(1800.0, 3000)
    table = solve_modes(environment, NEAR, 1800.0)
    np.testing.assert_allclose(table.wavenumber, expected, atol=2e-5)
    fast = expected < 2 * np.pi * NEAR / 1750.0  # they cross, and decay in no layer: the recursion is stable
    assert fast.sum() > 5
    kz = np.sqrt((2 * np.pi * NEAR / SPEED) ** 2 - expected[fast] ** 2)
    psi = np.sin(kz * table.depth[:, None]) / kz / np.sqrt(stack(expected[fast])[1])
    sign = np.sign(np.sum(psi * table.psi[:, fast], axis=0))
    np.testing.assert_allclose(sign * table.psi[:, fast], psi, atol=0.02 * np.abs(psi).max())


@pytest.mark.parametrize("frequency", [10.0, 12.0])
def test_cutoff_of_a_pekeris_guide(frequency):
    """Below `c / (4 D sqrt(1 - (c / c_bottom)^2))`, 10.78 Hz, nothing is trapped."""
    environment = over(HalfSpace(1600.0, 1.5, 0.0))
    if frequency < SPEED / (4 * DEPTH * np.sqrt(1 - (SPEED / 1600.0) ** 2)):
        with pytest.raises(ModeSolverError, match=r"no mode at 10.0 Hz.*cutoff of the waveguide.*1600.0 m/s"):
            solve_modes(environment, frequency, 1599.9)
    else:
        expected = Stack(environment, frequency).roots(1599.9, 1000)
        assert len(expected) == 1
        np.testing.assert_allclose(
            solve_modes(environment, frequency, 1599.9).wavenumber, expected, rtol=1e-6
        )


def test_mesh_error_is_small_at_the_highest_tone(swellex):
    table = solve_modes(swellex, 388.0)
    finest = solve_modes(swellex, 388.0, points_per_wavelength=96.0)
    assert len(table.wavenumber) == len(finest.wavenumber)
    assert np.abs(table.wavenumber - finest.wavenumber).max() * 5000 < 0.1 / 10  # rad; ten times better
    np.testing.assert_allclose(table.attenuation, finest.attenuation, rtol=1e-3)
    sign = np.sign(np.sum(table.psi * finest.psi, axis=0))
    np.testing.assert_allclose(table.psi * sign, finest.psi, atol=1e-3 * np.abs(finest.psi).max())
    np.testing.assert_allclose(table.slope * sign, finest.slope, atol=1e-3 * np.abs(finest.slope).max())


def test_extrapolation_is_what_makes_the_mesh_good_enough(swellex):
    finest = solve_modes(swellex, 388.0, points_per_wavelength=96.0)
    mesh = _build_mesh(swellex, 388.0, 1750.0, 16.0)
    single = np.sqrt(_solve_mesh(mesh, 388.0, 1750.0)[0])[: len(finest.wavenumber)]
    assert np.abs(single - finest.wavenumber).max() * 5000 > 0.1


def test_false_bottom_does_not_matter(swellex, monkeypatch):
    near = solve_modes(swellex, 49.0)
    monkeypatch.setattr("torchdt.field.waveguide.modes._DECAY_NEPERS", 40.0)
    far = solve_modes.__wrapped__(swellex, 49.0)
    np.testing.assert_allclose(near.wavenumber, far.wavenumber, atol=1e-10)
    np.testing.assert_allclose(near.attenuation, far.attenuation, rtol=1e-7)


def test_modes_are_orthonormal(swellex):
    mesh = _build_mesh(swellex, 112.0, 1750.0, 16.0)
    _, _, psi = _solve_mesh(mesh, 112.0, 1750.0)
    weight = np.pad(mesh.size / mesh.density / 2, (0, 1)) + np.pad(mesh.size / mesh.density / 2, (1, 0))
    np.testing.assert_allclose(psi.T @ (weight[:, None] * psi), np.eye(psi.shape[1]), atol=1e-9)


def test_modes_satisfy_the_wave_equation_in_the_water(swellex):
    table = solve_modes(swellex, 201.0)
    step = table.depth[1] - table.depth[0]
    inner = slice(100, -1)  # below the thermocline, where the kinks of the profile are weak
    curvature = np.gradient(table.slope, step, axis=0)[inner]
    speed = np.interp(table.depth, *np.array(swellex.profile).T)[inner, None]
    expected = (table.wavenumber**2 - (2 * np.pi * 201.0 / speed) ** 2) * table.psi[inner]
    np.testing.assert_allclose(curvature, expected, atol=0.01 * np.abs(expected).max())


def test_tables_are_cached_and_read_only(swellex):
    table = solve_modes(swellex, 79.0)
    assert solve_modes(swellex.perturbed(), 79.0) is table
    with pytest.raises(ValueError, match="read-only"):
        table.psi[0] = 1.0


def test_no_mode_is_an_error_with_a_name(swellex):
    with pytest.raises(ModeSolverError, match="no mode"):
        solve_modes(swellex, 1.5)


def test_disagreeing_meshes_are_an_error_with_a_name(swellex):
    with pytest.raises(ModeSolverError, match="raise points_per_wavelength"):
        solve_modes(swellex, 388.0, points_per_wavelength=2.5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"frequency": 0.0}, "frequency is 0"),
        ({"frequency": 100.0, "max_phase_speed": 5200.0}, "half-space, 5200"),
        ({"frequency": 100.0, "grid_step": -1.0}, "grid_step is -1"),
        ({"frequency": 100.0, "points_per_wavelength": float("nan")}, "points_per_wavelength is nan"),
    ],
)
def test_wrong_input_is_named(swellex, arguments, message):
    with pytest.raises(ValueError, match=message):
        solve_modes(swellex, **arguments)
