import math

import pytest
import torch
from oracles.line_array import BEARING, make_field
from scipy.stats import chi2

from torchdt.simulation.settings import (
    CoordinateSettings,
    InterfererSettings,
    PathSettings,
    ScenarioSettings,
    SourceSettings,
)
from torchdt.simulation.simulate import simulate_interference, simulate_snapshots, source_track

FIELD = make_field()
STILL = {"still": PathSettings([0.0], [[20.0]])}


def scenario(**settings) -> ScenarioSettings:
    settings = {"num_steps": 30, "num_snapshots": 4, "snr_db": 10.0, "paths": STILL} | settings
    return ScenarioSettings(coordinates=[CoordinateSettings(**BEARING)], **settings)


def draw(settings: ScenarioSettings, seed: int = 1):
    return simulate_snapshots(FIELD, settings, torch.Generator().manual_seed(seed))


def assert_energy(values: torch.Tensor, variance: float) -> None:
    """Circular complex normal values of this variance: 2 |z|^2 / variance is chi-squared; two-sided, false
    alarm of 1e-6."""
    degrees = 2 * values.numel()
    statistic = 2 * values.abs().square().sum().item() / variance
    assert chi2.ppf(5e-7, degrees) < statistic < chi2.ppf(1 - 5e-7, degrees)


def test_noise_alone():
    """Variance 1 / M at 0 dB: a source of 0 dB then has the noise's power at every element."""
    snapshots, truth = draw(scenario(snr_db=10.0))
    assert snapshots.shape == (30, 2, 4, 8)
    assert snapshots.dtype == torch.complex128
    assert truth.shape == (30, 0, 1)
    assert_energy(snapshots, 0.1 / 8)
    # Circular: real and imaginary parts share the power evenly and are not correlated.
    assert_energy(torch.complex(snapshots.real[..., ::2], snapshots.real[..., 1::2]), 0.1 / 8)
    skew = (snapshots.real * snapshots.imag).mean() / (0.1 / 16)
    assert skew.abs() < 5.2 / snapshots.numel() ** 0.5


@pytest.mark.parametrize(("snr_db", "power_db"), [(10.0, 0.0), (0.0, -6.0), (-10.0, 20.0)])
def test_signal_to_noise_ratio_of_every_element(snr_db, power_db):
    sources = {"a": SourceSettings("still", power_db)}
    settings = scenario(snr_db=snr_db, sources=sources, num_steps=200)
    snapshots, _ = draw(settings)
    # Without the noise: one and the same stream once with a far weaker noise.
    quiet, _ = draw(scenario(snr_db=400.0, sources=sources, num_steps=200))
    noise = snapshots - quiet
    for m in range(8):
        assert_energy(quiet[..., m], 10 ** (power_db / 10) / 8)
        assert_energy(noise[..., m], 10 ** (-snr_db / 10) / 8)
    response = FIELD(torch.tensor([20.0], dtype=torch.float64))
    amplitude = (response.conj()[:, None] * quiet).sum(-1, keepdim=True)
    torch.testing.assert_close(amplitude * response[:, None], quiet)


def test_constant_modulus_walks_in_phase():
    sources = {"a": SourceSettings("still", 6.0)}
    settings = scenario(
        snr_db=400.0, sources=sources, amplitudes="constant_modulus", phase_step_deg=20.0, num_steps=500
    )
    snapshots, _ = draw(settings)
    response = FIELD(torch.tensor([20.0], dtype=torch.float64))
    amplitude = (response.conj()[:, None] * snapshots).sum(-1)  # (K, I, J)
    torch.testing.assert_close(amplitude.abs(), torch.full_like(amplitude.abs(), 10**0.3))
    # The walk runs on from step to step: snapshots in time order, per tone.
    series = amplitude.transpose(0, 1).flatten(1)
    turn = (series[:, 1:] * series[:, :-1].conj()).angle()
    number = turn.numel()
    assert turn.mean().abs() < 5.2 * math.radians(20) / number**0.5
    spread = turn.square().sum().item() / math.radians(20) ** 2
    assert chi2.ppf(5e-7, number) < spread < chi2.ppf(1 - 5e-7, number)
    assert not torch.allclose(series[0], series[1])


def test_a_frozen_source_repeats_itself():
    path = {"line": PathSettings([0.0, 29.0], [[0.0], [29.0]])}
    settings = scenario(snr_db=400.0, paths=path, sources={"a": SourceSettings("line", frozen_step=7)})
    snapshots, truth = draw(settings)
    assert truth.eq(7.0).all()
    torch.testing.assert_close(snapshots, snapshots[:1].expand_as(snapshots), rtol=0, atol=1e-12)
    assert not torch.allclose(snapshots[0, 0, 0], snapshots[0, 0, 1])


def test_silence_birth_and_death():
    source = SourceSettings("still", birth=3, death=20, silences=[[5, 7], [19, 25]])
    snapshots, truth = draw(scenario(snr_db=400.0, sources={"a": source}))
    there = torch.zeros(30, dtype=torch.bool)
    there[3:20] = True
    assert torch.equal(~truth[:, 0, 0].isnan(), there)
    sending = there.clone()
    sending[5:8] = False
    sending[19] = False
    assert torch.equal(snapshots.abs().amax((1, 2, 3)) > 1e-6, sending)


def test_an_absent_source_changes_no_other():
    """Every source draws its numbers whether it is there or not."""
    late = {"a": SourceSettings("still", birth=10), "b": SourceSettings("still", -3.0)}
    early = {"a": SourceSettings("still"), "b": SourceSettings("still", -3.0)}
    (one, _), (other, _) = draw(scenario(sources=late)), draw(scenario(sources=early))
    assert torch.equal(one[10:], other[10:])
    assert not torch.equal(one[:10], other[:10])


def test_the_seed_decides():
    settings = scenario(sources={"a": SourceSettings("still")})
    assert torch.equal(draw(settings, 1)[0], draw(settings, 1)[0])
    assert not torch.equal(draw(settings, 1)[0], draw(settings, 2)[0])


def test_an_interferer_is_heard_and_is_no_object():
    """It is received like a source of its path, outside the region too, with Gaussian amplitudes."""
    outside = {"outside": PathSettings([0.0], [[BEARING["high"] + 10.0]])}
    ship = InterfererSettings("outside", 10.0, birth=2, silences=[[5, 7]])
    settings = scenario(
        paths=outside, interferers={"ship": ship}, amplitudes="constant_modulus", num_steps=200
    )
    heard = simulate_interference(FIELD, settings, torch.Generator().manual_seed(1))
    sent = torch.ones(200, dtype=torch.bool)
    sent[[0, 1, 5, 6, 7]] = False
    assert torch.equal(heard.abs().amax((1, 2, 3)) > 0, sent)
    response = FIELD(torch.tensor(outside["outside"].positions, dtype=torch.float64))[0]
    amplitude = (response.conj()[:, None] * heard).sum(-1, keepdim=True)
    torch.testing.assert_close(amplitude * response[:, None], heard)
    assert_energy(amplitude[sent], 10.0)
    _, truth = draw(settings)
    assert truth.shape == (200, 0, 1)
    assert not simulate_interference(FIELD, scenario(), torch.Generator()).any()


def test_a_spline_passes_its_waypoints_smoothly():
    times, positions = [0.0, 8.0, 20.0, 40.0], [[0.0, 5.0], [10.0, 9.0], [-4.0, 7.0], [3.0, 8.0]]
    track = source_track(SourceSettings("p"), PathSettings(times, positions), 81, 0.5)
    assert track.dtype == torch.float64
    for t, p in zip(times, positions, strict=True):
        torch.testing.assert_close(track[round(t / 0.5)], torch.tensor(p, dtype=torch.float64))
    bend = track.diff(dim=0).diff(dim=0).abs().amax()
    corner = torch.tensor([10.0 / 8, -14.0 / 12]).diff().abs() * 0.5  # of straight legs
    assert bend < 0.5 * corner


def test_two_waypoints_are_a_line_and_one_stands_still():
    line = source_track(SourceSettings("p"), PathSettings([2.0, 4.0], [[10.0], [14.0]]), 6, 1.0)
    assert line[:, 0].tolist() == [6.0, 8.0, 10.0, 12.0, 14.0, 16.0]
    still = source_track(SourceSettings("p", birth=1), PathSettings([0.0], [[3.0]]), 3, 1.0)
    assert still[1:, 0].tolist() == [3.0, 3.0]
    assert still[0].isnan().all()
