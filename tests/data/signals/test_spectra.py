import math

import numpy as np
import pytest
import torch
from oracles.devices import assert_kind, foreign_defaults

from torchdt.core.errors import InputError
from torchdt.data.signals.spectra import tone_snapshots

RATE, FREQS = 1500.0, (49.0, 201.0)
SIZES = {"window_length": 512, "hop": 256, "snapshots_per_step": 3, "search_hz": 3.0}
M, SPAN, ADVANCE = 4, 2 * 256 + 512, 3 * 256


def tones(num_samples, amplitude, phase, freqs):
    """Cosines (M, samples); amplitude and phase (I, M), freqs (I,) or (I, samples) Hz."""
    freqs = np.broadcast_to(np.asarray(freqs, float).reshape(len(freqs), -1), (len(freqs), num_samples))
    turns = np.cumsum(freqs, -1) / RATE - freqs[:, :1] / RATE
    waves = amplitude[..., None] * np.cos(2 * np.pi * turns[:, None] + phase[..., None])
    return torch.from_numpy(waves.sum(0))


@pytest.fixture
def generator():
    return np.random.default_rng(0)


def snapshots(signal, freqs=FREQS, rate=RATE, **changed):
    return tone_snapshots([signal], rate, freqs, **(SIZES | changed))


def test_tones_in_the_middle_of_a_bin_are_recovered(generator):
    bins = np.array([17, 69])  # next to 49 and 201 Hz
    amplitude, phase = generator.uniform(1, 2, (2, M)), generator.uniform(-3, 3, (2, M))
    z = snapshots(tones(2 * ADVANCE + SPAN, amplitude, phase, bins * RATE / 512)).numpy()
    assert z.shape == (3, 2, 3, M)
    starts = 256 * np.arange(9).reshape(3, 3)
    turn = np.exp(2j * np.pi * bins[:, None] / 512 * starts[:, None])  # (K, I, J)
    np.testing.assert_allclose(z, turn[..., None] * (amplitude * np.exp(1j * phase))[:, None], rtol=1e-3)


def test_phases_between_sensors_hold_off_the_bins(generator):
    """All sensors share what lies between tone and bin; 0.5 bins away, up to leakage of the other terms."""
    amplitude, phase = generator.uniform(1, 2, (2, M)), generator.uniform(-3, 3, (2, M))
    z = snapshots(tones(SPAN, amplitude, phase, FREQS)).numpy()
    wanted = amplitude / amplitude[:, :1] * np.exp(1j * (phase - phase[:, :1]))
    np.testing.assert_allclose(
        z / z[..., :1], np.broadcast_to(wanted[:, None], z.shape[1:])[None], rtol=1e-3, atol=1e-3
    )


@pytest.mark.parametrize("bins", [-2, -1, 1, 2])
def test_the_search_finds_a_shifted_tone(bins):
    nominal, ones = 69 * RATE / 512, np.ones((1, M))
    signal = tones(SPAN, ones, 0 * ones, [nominal + bins * RATE / 512])
    found, fixed = (snapshots(signal, [nominal], search_hz=s).abs() for s in (6.0, 0.0))
    torch.testing.assert_close(found, torch.ones_like(found), rtol=1e-3, atol=0)
    left = {1: 0.5, 2: 0.0}[abs(bins)]  # of the Hann window's transform
    torch.testing.assert_close(fixed, torch.full_like(fixed, left), rtol=0, atol=1e-2)


def test_each_step_has_its_bin_and_its_sensors_share_it():
    """A tone that rises from 199 to 203 Hz, and one sensor with a stronger tone elsewhere in the search."""
    time = 20 * ADVANCE + SPAN
    rising = tones(time, np.ones((1, M)), np.zeros((1, M)), np.linspace(199, 203, time)[None])
    assert (snapshots(rising, [201.0]).abs() > 0.8).all()
    split = tones(SPAN, np.ones((1, M)), np.zeros((1, M)), [16 * RATE / 512])
    split[0] = 1.5 * tones(SPAN, np.ones((1, 1)), np.zeros((1, 1)), [19 * RATE / 512])[0]
    z = snapshots(split, [51.0], search_hz=6.0).abs()  # energy 2.25 in bin 19, and 3 in bin 16
    assert (z[..., 1:] > 0.99).all()
    assert (z[..., 0] < 0.1).all()


def test_white_noise_has_the_stated_power():
    """Mean of 2400 exponential values for each tone, none of them sharing a sample.

    Beyond 5 standard errors: 6e-7 for a normal mean, below 3e-6 with the skewness of this one; two tones.
    """
    variance, steps, generator = 2.5, 600, torch.Generator().manual_seed(1)
    noise = variance**0.5 * torch.randn(M, 512 * steps, generator=generator, dtype=torch.float64)
    z = snapshots(noise, search_hz=0.0, hop=512, snapshots_per_step=1)
    assert len(z) == steps
    window = 0.5 - 0.5 * torch.cos(2 * math.pi * torch.arange(512) / 512).double()
    expected = 4 * variance * window.square().sum() / window.sum() ** 2
    power = z.abs().square().mean((0, 2, 3)) / expected
    assert (power - 1).abs().max() < 5 / math.sqrt(steps * M)


@pytest.mark.parametrize("size", [1, 100, 512, 1023, 5000])
def test_blocks_do_not_matter(size):
    signal = torch.randn(M, 5 * ADVANCE, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    whole = snapshots(signal)
    pieces = tone_snapshots(iter(signal.split(size, -1)), RATE, FREQS, **SIZES)
    assert len(whole) == 4
    assert torch.equal(pieces, whole)


def test_steps_with_all_their_windows_count():
    signal = torch.ones(M, SPAN + 2 * ADVANCE)
    lengths = (SPAN, SPAN + 2 * ADVANCE - 1, SPAN + 2 * ADVANCE)
    assert [len(snapshots(signal[:, :length])) for length in lengths] == [1, 2, 3]


def test_twenty_minutes_of_the_paper_are_292_steps():
    blocks = (torch.zeros(1, 6144) for _ in range(1200 * 1500 // 6144 + 1))
    sizes = {"window_length": 4096, "hop": 2048, "snapshots_per_step": 3, "search_hz": 1.0}
    assert len(tone_snapshots(blocks, 1500, FREQS, **sizes)) == 292


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_type_of_the_blocks(dtype):
    signal = torch.ones(M, SPAN, dtype=dtype)
    with foreign_defaults(dtype):
        assert_kind(snapshots(signal), dtype)


def test_arrays_are_as_good_as_tensors(generator):
    signal = generator.standard_normal((M, 3 * SPAN))
    assert torch.equal(snapshots(signal), snapshots(torch.from_numpy(signal)))


def test_missing_samples_are_missing_snapshots():
    """The others stay: the bin is that of the rest, which is not the first of the search."""
    signal = tones(SPAN, np.ones((2, M)), np.zeros((2, M)), FREQS)
    whole = snapshots(signal)
    signal[1, 10] = torch.nan  # in the first window alone
    z = snapshots(signal)
    assert z.isnan().nonzero().tolist() == [[0, i, 0, 1] for i in range(2)]
    assert torch.equal(z[~z.isnan()], whole[~z.isnan()])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"freqs": [100.0, 760.0]},
            "'field.freqs': found 760.0 Hz .*expected less than the Nyquist frequency 750.0 Hz",
        ),
        ({"freqs": [749.0]}, "'field.freqs': found 749.0 Hz and a search of 3.0"),
        ({"freqs": [2.0]}, "'data.search_hz': found 3.0, expected less, which keeps 2.0 Hz"),
        ({"freqs": [201.0, 204.0]}, "'data.search_hz': found 3.0, expected less than half the way"),
        ({"window_length": 3}, "'data.window_length': found 3, expected 4"),
        ({"hop": 513}, "'data.hop': found 513, expected from 1 to the window_length 512"),
        ({"hop": 0}, "'data.hop': found 0"),
        ({"snapshots_per_step": 0}, "'data.snapshots_per_step': found 0"),
        ({"search_hz": -1.0}, "'data.search_hz': found -1.0"),
        ({"rate": 0.0}, "'data.sample_rate': found 0.0"),
    ],
)
def test_what_makes_no_sense(changed, message):
    with pytest.raises(InputError, match=message):
        snapshots(torch.ones(M, SPAN), **changed)


def test_signals_that_do_not_fit():
    with pytest.raises(InputError, match=f"found too few samples for a step, expected {SPAN}"):
        snapshots(torch.ones(M, SPAN - 1))
    with pytest.raises(InputError, match="found infinite samples"):
        snapshots(torch.full((M, SPAN), torch.inf))
