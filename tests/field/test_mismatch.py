"""Responses known in part: the modes added up without their phases, and what is made of them."""

import math

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline

from torchdt.field import Field, NormalModeField, solve_modes
from torchdt.field.mismatch import MismatchedField

F64 = torch.float64
TONES = (49.0, 148.0, 388.0)
POSITION = (2345.0, 57.0)


def mode_terms(environment, frequency, sensors, tilt):
    """`(M, N)` terms of the mode sum, every sensor at its own range, by splines on a finer mesh."""
    distance, depth = POSITION
    table = solve_modes(environment, frequency, points_per_wavelength=64.0, grid_step=0.1)
    spline = CubicSpline(table.depth, table.psi)
    sensors = np.array(sensors)
    ranges = distance - (sensors.max() - sensors) * math.tan(math.radians(tilt))
    k = table.wavenumber - 1j * table.attenuation
    terms = spline(depth) * spline(sensors) * np.exp(-1j * k * ranges[:, None])
    return terms / np.sqrt(table.wavenumber * distance)


@pytest.fixture(scope="module")
def states() -> torch.Tensor:
    unit = torch.rand(3, 5, 4, generator=torch.Generator().manual_seed(2), dtype=F64)
    return unit * torch.tensor([4000.0, 200.0, 1.0, 1.0]) + torch.tensor([500.0, 5.0, 0.0, 0.0])


@pytest.mark.parametrize("tilt", [0.0, 2.0, -1.0])
def test_incoherent_is_the_mean_over_random_mode_phases(swellex, sensors, tilt):
    """Powers in 40 random directions against 2000 draws of independent uniform phases.

    A power is exponentially distributed, so its mean is off by 5 standard errors in one of a million
    cases, and in 1e-4 of the runs of 120 directions.
    """
    rng = np.random.default_rng(5)
    field = NormalModeField(swellex, TONES, sensors, tilt, normalize=False, dtype=F64)
    position = torch.tensor(POSITION, dtype=F64)
    found = field.incoherent(position).numpy()
    for i, frequency in enumerate(TONES):
        terms = mode_terms(swellex, frequency, sensors, tilt)
        phase = np.exp(2j * np.pi * rng.random((2000, terms.shape[1])))
        draws = phase @ terms.T
        # The trace is the energy of the response itself, which differs from the mean over the phases.
        energy = float(field(position)[i].abs().square().sum())
        draws *= math.sqrt(energy / (np.abs(terms) ** 2).sum())
        direction = rng.standard_normal((len(sensors), 40)) + 1j * rng.standard_normal((len(sensors), 40))
        power = np.abs(draws @ direction.conj()) ** 2
        expected = np.einsum("mu,mk,ku->u", direction.conj(), found[i], direction).real
        error = (power.mean(0) - expected) / (power.std(0) / math.sqrt(len(draws)))
        assert np.abs(error).max() < 5
        # Whole matrix: K draws of n-dimensional Gaussian-like vectors leave an error of trace / sqrt(K).
        sample = draws.T @ draws.conj() / len(draws)
        assert np.linalg.norm(sample - found[i]) < 1.5 * energy / math.sqrt(len(draws))


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("tilt", [0.0, 1.5, torch.tensor(1.5, dtype=F64)])
def test_incoherent_is_a_covariance_with_the_energy_of_the_response(
    swellex, sensors, states, normalize, tilt
):
    field = NormalModeField(swellex, TONES, sensors, tilt, normalize=normalize, dtype=F64)
    found = field.incoherent(states)
    assert found.shape == (3, 5, 3, 21, 21)
    torch.testing.assert_close(found, found.mH)
    assert (torch.linalg.eigvalsh(found)[..., 0] > -1e-12 * found.abs().amax((-2, -1))).all()
    trace = found.diagonal(dim1=-2, dim2=-1).real.sum(-1)
    torch.testing.assert_close(trace, field(states).abs().square().sum(-1), rtol=1e-9, atol=0.0)


def test_incoherent_takes_states_one_by_one_and_in_single_precision(swellex, sensors, states):
    field = NormalModeField(swellex, TONES, sensors, 1.0, dtype=F64)
    single = NormalModeField(swellex, TONES, sensors, 1.0, dtype=torch.float32)
    together = field.incoherent(states)
    torch.testing.assert_close(field.incoherent(states[1, 2]), together[1, 2])
    found = single.incoherent(states.float())
    assert found.dtype == torch.complex64
    torch.testing.assert_close(found, together.to(torch.complex64), rtol=0.0, atol=2e-4)


def test_mismatched_field_splits_the_energy(swellex, sensors, states):
    field = NormalModeField(swellex, TONES, sensors, 1.0, dtype=F64)
    share = torch.tensor([0.0, 0.1, 0.6], dtype=F64)
    mismatched = MismatchedField(field, share)
    assert isinstance(mismatched, Field)
    assert field.diffuse(states) is None
    coherent, diffuse = mismatched(states), mismatched.diffuse(states)
    energy = field(states).abs().square().sum(-1)
    scattered = diffuse.diagonal(dim1=-2, dim2=-1).real.sum(-1)
    torch.testing.assert_close(coherent.abs().square().sum(-1) + scattered, energy)
    torch.testing.assert_close(scattered / energy, share.expand_as(energy), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(
        coherent, field(states) * torch.tensor([1.0, 0.9, 0.4]).double().sqrt()[:, None]
    )
    torch.testing.assert_close(diffuse[..., 1, :, :], 0.1 * field.incoherent(states)[..., 1, :, :])


def test_second_moment_of_mode_phases_off_by_normal_errors(swellex, sensors):
    """The reason of the model: mean of a a^H is `exp(-v) a a^H + (1 - exp(-v)) R`, modes of any strength."""
    rng = np.random.default_rng(7)
    frequency, variance, num_draws = 148.0, 0.3, 4000
    terms = mode_terms(swellex, frequency, sensors, 0.0)
    draws = np.exp(1j * math.sqrt(variance) * rng.standard_normal((num_draws, terms.shape[1]))) @ terms.T
    field = NormalModeField(swellex, (frequency,), sensors, normalize=False, dtype=F64)
    position = torch.tensor(POSITION, dtype=F64)
    response = field(position)[0].numpy()
    kept = math.exp(-variance)
    # `incoherent` is scaled to the energy of the response; here the modes keep their own.
    scale = (np.abs(terms) ** 2).sum() / (np.abs(response) ** 2).sum()
    scattered = (1 - kept) * scale * field.incoherent(position)[0].numpy()
    expected = kept * np.outer(response, response.conj()) + scattered
    sample = draws.T @ draws.conj() / num_draws
    assert np.linalg.norm(sample - expected) < 2 * np.trace(expected).real / math.sqrt(num_draws)
