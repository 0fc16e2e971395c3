import math

import numpy as np
import pytest
import torch
from oracles.waveguide import DEPTHS, FREQS, WATER, configured

from torchdt.field import Environment, HalfSpace, NormalModeField, solve_modes
from torchdt.field.build import waveguide
from torchdt.field.waveguide.sloped import SlopedField

DOUBLE = torch.float64
STATES = torch.tensor([[1.0, 30.0], [700.0, 8.0], [2500.0, 55.0], [5200.0, 90.0]], dtype=DOUBLE)


def sloped(slope: float, environment: Environment = WATER, length: float = 5000.0, **options) -> SlopedField:
    return SlopedField(environment, FREQS, DEPTHS, 1.0, slope=slope, length=length, dtype=DOUBLE, **options)


@pytest.fixture(scope="module")
def field() -> SlopedField:
    """100 m of water at the array, 85 m from 5 km on."""
    return sloped(0.003, normalize=False)


def test_no_slope_is_the_flat_field():
    flat, level = NormalModeField(WATER, FREQS, DEPTHS, 1.0, bow=2.0, dtype=DOUBLE), sloped(0.0, bow=2.0)
    torch.testing.assert_close(level(STATES), flat(STATES), rtol=0, atol=1e-9)
    torch.testing.assert_close(level.incoherent(STATES), flat.incoherent(STATES), rtol=0, atol=1e-9)


def test_phases_of_a_small_slope():
    """Those of first-order perturbation: a boundary that moves by dD changes `k^2`, the stationary value of
    `integral (omega^2 / c^2 psi^2 - psi'^2) / rho dz`, by
    `dD (psi^2 [(k_1^2 - k^2) / rho_1 - (k_2^2 - k^2) / rho_2] + (psi' / rho)^2 (rho_1 - rho_2))`."""
    frequency, below = 148.0, HalfSpace(speed=1800.0, density=2.0, attenuation=0.1)
    pekeris = Environment(((0.0, 1500.0), (100.0, 1500.0)), (), below)
    slope, omega = 2e-5, 2 * math.pi * frequency
    field = SlopedField(pekeris, [frequency], DEPTHS, slope=slope, length=5000.0, dtype=DOUBLE)
    table = solve_modes(pekeris, frequency)
    k, psi, rise = table.wavenumber, table.psi[-1], table.slope[-1]
    water, rock = (omega / 1500) ** 2 - k**2, (omega / below.speed) ** 2 - k**2
    # psi' / rho is continuous, and that of the water is per density 1.
    of_depth = (psi**2 * (water - rock / below.density) + rise**2 * (1 - below.density)) / (2 * k)
    for distance in (1000.0, 4000.0, 7000.0):
        onto = min(distance, 5000.0)
        shallower = slope * (onto**2 / 2 + (distance - onto) * onto)  # integral over the way, m^2
        found = -2 * math.pi * field._travelled(torch.tensor([distance], dtype=DOUBLE))[0].numpy()
        change = found - k * distance
        assert np.abs(change).max() > 1e-3
        np.testing.assert_allclose(change, -of_depth * shallower, rtol=5e-3, atol=1e-7)


@pytest.mark.parametrize("distance", [1000.0, 4000.0, 5000.0, 8000.0])
def test_adiabatic_sum(field, distance):
    """By flat waveguides alone: wavenumbers integrated by quadrature, mode functions of the depth at source,
    all with the sign with which they rise below the surface."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    way = distance * (nodes + 1) / 2
    onto = min(distance, 5000.0)
    for i, frequency in enumerate(FREQS):
        here = solve_modes(WATER, frequency)
        there = solve_modes(WATER.perturbed(water_depth=100.0 - 0.003 * onto), frequency)
        num = len(there.wavenumber)
        turn = np.zeros(num, dtype=complex)
        for r, w in zip(way, weights * distance / 2, strict=True):
            local = solve_modes(WATER.perturbed(water_depth=100.0 - 0.003 * min(r, 5000.0)), frequency)
            turn += w * (local.wavenumber - 1j * local.attenuation)[:num]
        k = (here.wavenumber - 1j * here.attenuation)[:num]
        nearer = (DEPTHS[-1] - np.array(DEPTHS)) * math.tan(math.radians(1.0))
        at_array, at_source = (
            np.stack([np.interp(z, t.depth, mode) for mode in (t.psi * np.sign(t.slope[0])).T[:num]])
            for z, t in ((np.array(DEPTHS), here), (np.array([40.0]), there))
        )
        terms = at_source * at_array * np.exp(-1j * (turn[:, None] - k[:, None] * nearer))
        expected = (terms / np.sqrt(k.real * distance)[:, None]).sum(0)
        response = field(torch.tensor([distance, 40.0], dtype=DOUBLE))[i].numpy()
        assert np.linalg.norm(response - expected) < 0.02 * np.linalg.norm(expected)


def test_modes_that_are_lost_on_the_way_fade():
    """None of them reaches the array from the shallow end, and nothing jumps where they go."""
    steep = sloped(0.008, normalize=False)
    end = NormalModeField(WATER.perturbed(water_depth=60.0), FREQS, [30.0])
    assert end.mode_counts[1] < steep.mode_counts[1]
    distance = torch.linspace(1, 6000, 60000, dtype=DOUBLE)
    amplitude = steep._amplitudes(distance, torch.full_like(distance, 40.0))
    heard = amplitude[-1].split(steep.mode_counts)
    assert [int((part != 0).sum()) for part in heard] == end.mode_counts
    assert amplitude.diff(dim=0).abs().max() < 2e-3 * amplitude.abs().max()


def test_the_type_leaves_phases_alone():
    single = sloped(0.003).float()
    response = single(STATES.float())
    assert response.dtype == torch.complex64
    torch.testing.assert_close(response.to(torch.complex128), sloped(0.003)(STATES), rtol=0, atol=1e-3)


@pytest.mark.parametrize(("slope", "length"), [(0.02, 5000.0), (math.nan, 5000.0), (0.001, 0.0)])
def test_a_slope_leaves_water(slope, length):
    with pytest.raises(ValueError, match=r"slope is .* expected a finite one that leaves some of 100.0 m"):
        sloped(slope, length=length)


def test_configured():
    """A slope makes the field."""
    short = configured(freqs=[49], slope_m_per_km=2.0, slope_length_m=1000.0)
    made = waveguide(**short, dtype=DOUBLE)
    assert isinstance(made, SlopedField)
    assert (made.slope, made.length) == (0.002, 1000.0)
