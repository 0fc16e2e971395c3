import math

import pytest
import torch
from oracles.line_array import Silent
from oracles.line_array import make_field as make_line
from oracles.waveguide import DEPTHS, FREQS, WATER, make_field
from scipy.stats import binom, chi2

from torchdt.core.errors import InputError
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.simulation.disturbances import (
    DisturbanceSettings,
    GainJumpSettings,
    NoiseColourSettings,
    add_impulses,
    coloured_noise,
    disturb,
    noise_covariance,
)

WAVEGUIDE = make_field(torch.float64)
COLOUR = NoiseColourSettings([6.0, 0.0], 0.8, 0.5, [[500.0, 1.0], [3000.0, 1.0]])
VARIANCE = 0.3


def generator(seed: int = 1) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def snapshots(steps: int = 20) -> torch.Tensor:
    return torch.randn(steps, 2, 3, 11, generator=generator(7), dtype=torch.complex128)


def disturbed(**settings) -> torch.Tensor:
    return disturb(snapshots(), DisturbanceSettings(**settings), WAVEGUIDE, VARIANCE, generator())


def test_nothing_by_default():
    """The very numbers, and none are drawn."""
    stream = generator()
    before = stream.get_state()
    z = snapshots()
    assert disturb(z, DisturbanceSettings(), WAVEGUIDE, VARIANCE, stream) is z
    assert torch.equal(stream.get_state(), before)


def test_exponential_part():
    covariance = noise_covariance(NoiseColourSettings([3.0], 0.5), make_line())
    assert covariance.shape == (2, 8, 8)
    for m in range(8):
        for n in range(8):
            expected = 10**0.3 * 0.5 ** abs(m - n)
            torch.testing.assert_close(covariance[:, m, n].real, torch.full((2,), expected).double())


def test_part_of_the_surface():
    """As much of each sensor's noise, and as alike, as of shallow sources in all of many ranges."""
    covariance = noise_covariance(NoiseColourSettings([0.0], 0.0, 1.0, [[3000.0, 5.0]]), WAVEGUIDE)
    power = covariance.diagonal(dim1=-2, dim2=-1).real
    torch.testing.assert_close(power.mean(-1), torch.ones(2).double())
    distance = torch.linspace(2000, 4000, 4001, dtype=torch.float64)
    sounding = NormalModeField(WATER, FREQS, DEPTHS, normalize=False, dtype=torch.float64)
    response = sounding(torch.stack([distance, torch.full_like(distance, 5.0)], -1)).transpose(0, 1)
    sampled = response.mT @ response.conj()
    norm = sampled.norm(dim=(-2, -1)) * covariance.norm(dim=(-2, -1))
    alike = (sampled * covariance.conj()).sum((-2, -1)).real / norm
    assert alike.min() > 0.98


def test_noise_has_its_covariance():
    """Whitened energy is chi-squared, two-sided, false alarm 1e-6; so is that of a sum of the sensors."""
    covariance = VARIANCE * noise_covariance(COLOUR, WAVEGUIDE)
    noise = coloured_noise(covariance, (200, 2, 3, 11), generator())
    beam = torch.exp(1j * torch.arange(11)).to(torch.complex128)
    for i in range(2):
        z = noise[:, i].reshape(-1, 11)
        white = torch.linalg.solve(torch.linalg.cholesky(covariance[i]), z.mT)
        heard = z @ beam.conj() / (beam.conj() @ covariance[i] @ beam).real.sqrt()
        for values in (white, heard):
            degrees = 2 * values.numel()
            energy = 2 * values.abs().square().sum().item()
            assert chi2.ppf(5e-7, degrees) < energy < chi2.ppf(1 - 5e-7, degrees)


def test_coloured_noise_is_added():
    covariance = VARIANCE * noise_covariance(COLOUR, WAVEGUIDE)
    expected = snapshots() + coloured_noise(covariance, (20, 2, 3, 11), generator())
    assert torch.equal(disturbed(noise_colour=COLOUR), expected)


def test_gains():
    jumps = [GainJumpSettings(3, 5, 1000.0), GainJumpSettings(5, None, 0.5)]
    gain = torch.ones(20, 11, dtype=torch.float64)
    gain[:, 4], gain[:, 9] = 0.0, 10.0
    gain[3:6] *= 1000
    gain[5:] *= 0.5
    found = disturbed(sensor_factors={4: 0.0, 9: 10.0}, gain_jumps=jumps)
    torch.testing.assert_close(found, snapshots() * gain[:, None, None])


def test_offset():
    """The same in every snapshot, of one magnitude and different phases."""
    offset = disturbed(offset=3.0) - snapshots()
    torch.testing.assert_close(offset, offset[:1, :, :1].expand_as(offset))
    torch.testing.assert_close(offset.abs(), torch.full_like(offset.abs(), 3 * math.sqrt(VARIANCE)))
    assert len(offset[0, :, 0].angle().flatten().unique()) == 22


def test_impulses():
    """As many as drawn independently, false alarm 1e-6, all else untouched."""
    z = snapshots(200)
    ratio = (add_impulses(z, 0.01, 100.0, generator()) / z).real
    hit = ratio > 2
    torch.testing.assert_close(ratio, torch.where(hit, 100.0, 1.0).double())
    assert binom.ppf(5e-7, z.numel(), 0.01) < hit.sum() < binom.ppf(1 - 5e-7, z.numel(), 0.01)


def refuse(make, key: str, expected: str) -> None:
    with pytest.raises(InputError, match=rf"key 'scenario.disturbances.{key}'.*expected {expected}"):
        make()


def test_bad_settings():
    refuse(
        lambda: NoiseColourSettings(correlation=1.0), "noise_colour.correlation", "a number from 0, below 1"
    )
    refuse(lambda: NoiseColourSettings(surface_share=0.1), "noise_colour.surface", "positions of the share")
    refuse(lambda: GainJumpSettings(4, 3), "gain_jumps.last", "a step from first, 4, up, or null")
    refuse(lambda: GainJumpSettings(factor=-1.0), "gain_jumps.factor", "a number from 0 up")
    refuse(lambda: DisturbanceSettings(impulse_share=1.5), "impulse_share", "a number from 0 to 1")
    refuse(lambda: DisturbanceSettings(sensor_factors={1: -1.0}), "sensor_factors", "values by name, each a")


def test_what_does_not_fit_the_field():
    refuse(lambda: disturbed(sensor_factors={11: 2.0}), "sensor_factors", "sensors from 0 to 10")
    of_three = NoiseColourSettings([1.0, 2.0, 3.0])
    refuse(
        lambda: noise_covariance(of_three, WAVEGUIDE), "noise_colour.level_db", "one number, or .* 2 tones"
    )
    flat = NoiseColourSettings(surface_share=0.5, surface=[[500.0]])
    refuse(lambda: noise_covariance(flat, WAVEGUIDE), "noise_colour.surface", "2 coordinates each")
    refuse(
        lambda: noise_covariance(flat, Silent(make_line())),
        "noise_colour.surface",
        "none: this field knows no",
    )
