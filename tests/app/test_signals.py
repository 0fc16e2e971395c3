"""Raw signals from files: what is read, scored and refused."""

import json

import numpy as np
import pytest
import torch
from oracles.signals import plane_wave_signals, write_sio
from scipy.io import wavfile

from torchdt.app.build import build_recording
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow
RATE, STEP_S, SPAN_S = 1500, 0.512, 1024 / 1500
FREQS, POSITIONS = (100.0, 150.0), tuple(range(0, 40, 5))
SIZES = ("data.window_length=512", "data.hop=256", "data.snapshots_per_step=3")
SECONDS = 12.0
BEARING = -20.0, 2.0  # degrees, degrees/s


@pytest.fixture(scope="module")
def samples():
    """A source that turns from -20 to 4 degrees, 19 dB over the noise in a window of 512 samples."""
    times = np.arange(int(SECONDS * RATE)) / RATE
    generator = np.random.default_rng(0)
    signals = plane_wave_signals(BEARING[0] + BEARING[1] * times, POSITIONS, FREQS, RATE, generator, 1.0)
    return np.round(2000 * signals).astype("i2")


@pytest.fixture
def files(samples, tmp_path):
    """The same signals in all formats, and their truth."""
    wavfile.write(tmp_path / "array.wav", RATE, samples.T)
    np.save(tmp_path / "array.npy", samples)
    write_sio(tmp_path / "array.sio", samples)
    ends = [f"{t},{BEARING[0] + BEARING[1] * t}" for t in (0.0, SECONDS)]
    (tmp_path / "truth.csv").write_text("\n".join(["time_s,boat_bearing", *ends]))
    return tmp_path


@pytest.fixture
def read(settings, files):
    def read(kind, *overrides):
        rate = () if kind == "wav" else (f"data.sample_rate={RATE}",)
        path = f"data.path={files / f'array.{kind}'}"
        group = "sio_whole" if kind == "sio" else kind
        return build_recording(settings(f"data={group}", path, *SIZES, *rate, *overrides))

    return read


@pytest.mark.parametrize("kind", ["wav", "npy", "sio"])
def test_all_formats_give_the_same(read, files, kind):
    recording = read(kind, f"data.truth={files / 'truth.csv'}")
    assert recording.snapshots.shape == (1, 23, 2, 3, 8)
    assert recording.step_s == STEP_S
    assert recording.name == "array"
    assert torch.equal(recording.snapshots, read("wav").snapshots)
    middle = SPAN_S / 2 + STEP_S * np.arange(23)
    np.testing.assert_allclose(recording.times()[0], middle)
    np.testing.assert_allclose(recording.truth[0, :, 0, 0], BEARING[0] + BEARING[1] * middle)


def test_a_part_of_the_file(read, files):
    whole, part = (
        read("wav", f"data.truth={files / 'truth.csv'}", *more)
        for more in ((), (f"data.start_s={2 * STEP_S}", f"data.duration_s={SPAN_S + STEP_S}"))
    )
    assert torch.equal(part.snapshots, whole.snapshots[:, 2:4])
    torch.testing.assert_close(part.truth, whole.truth[:, 2:4])
    torch.testing.assert_close(part.times(), whole.times()[:, 2:4])


def test_static_copy(read, files):
    truth = f"data.truth={files / 'truth.csv'}"
    alone, both = (
        read("wav", truth),
        read("wav", truth, "data.static_copy.step=7", "data.static_copy.gain_db=-6"),
    )
    expected = 10**-0.3 * alone.snapshots + alone.snapshots[:, 7:8]
    torch.testing.assert_close(both.snapshots, expected)
    assert both.truth.shape == (1, 23, 2, 1)
    assert (both.truth[0, :, 1] == alone.truth[0, 7]).all()


def test_tracked_from_a_file(launch, files):
    """A false or missed object costs 5; noise leaves an error of about 0.1 degrees."""
    limits = "scenario.coordinates.0.rate_low=-5", "scenario.coordinates.0.rate_high=5"
    path, truth = f"data.path={files / 'array.wav'}", f"data.truth={files / 'truth.csv'}"
    outcome = launch("data=wav", path, truth, *SIZES, *limits)
    assert outcome.status == 0, outcome.err
    assert outcome.json("metrics.json")["num_steps"] == 23
    assert max(outcome.scores[2:]) < 1.0
    assert json.loads((outcome.directory / "manifest.json").read_text())["config"]["data"]["kind"] == "wav"


def test_a_path_of_the_scenario_is_the_truth(read):
    """The first goes from -40 to 0 degrees in a minute, from where the segment starts."""
    recording = read("wav", "data.truth_path=first", "data.start_s=2")
    truth = recording.truth
    middle = SPAN_S / 2 + STEP_S * np.arange(truth.shape[1])
    np.testing.assert_allclose(truth[0, :, 0, 0], -40 + 40 / 60 * middle)
    np.testing.assert_allclose(recording.times()[0], 2 + middle)


def test_missing_samples(read, files, samples, caplog):
    broken = samples.astype("f4")
    broken[3] = np.nan
    np.save(files / "array.npy", broken)
    recording = read("npy")
    assert recording.snapshots.isnan().any(-2).any(1).nonzero().tolist() == [[0, i, 3] for i in range(2)]
    assert "dead channels of each sequence: [[3]]" in caplog.text


@pytest.mark.parametrize(
    ("kind", "overrides", "message"),
    [
        (
            "wav",
            ["data.sample_rate=1000"],
            "'data.sample_rate': found 1000.0 Hz, expected 1500.0 Hz, as in the",
        ),
        ("npy", ["data.sample_rate=null"], "'data.sample_rate': found None, expected Hz, which .npy files"),
        ("sio", ["data.sample_rate=null"], "'data.sample_rate': found None, expected Hz, which .sio files"),
        (
            "wav",
            ["field.sensor_positions=[0,5,10]"],
            "array.wav': 8 channels, expected 3, one for each sensor",
        ),
        (
            "wav",
            ["field.freqs=[100,800]"],
            "'field.freqs': found 800 Hz and a search of 1.0 Hz, expected less",
        ),
        ("wav", ["data.truth_path=third"], "'data.truth_path': found third, expected a path of the scenario"),
        ("wav", ["data.start_s=12"], "'data.start_s': found 12.0, expected less than the file's 12 s"),
        (
            "wav",
            ["data.start_s=2", "data.duration_s=11"],
            "'data.duration_s': found 11.0, expected at most 10 s",
        ),
        ("wav", ["data.duration_s=0.5"], "'data.path': found too few samples for a step, expected 1024"),
        ("wav", ["data.static_copy.step=23"], "'data.static_copy.step': found 23, expected 0 to 22"),
        (
            "wav",
            ["data.static_copy.gain_db=inf"],
            "'data.static_copy.gain_db': found inf, expected a finite",
        ),
        ("wav", ["data.hop=1000"], "'data.hop': found 1000, expected from 1 to the window_length 512"),
        (
            "wav",
            ["data.path=[a.wav,b.wav]"],
            "'data.path': found ['a.wav', 'b.wav'], expected the path of one",
        ),
        ("wav", ["data.path=null"], "'data.path': found None, expected the path of one file"),
        ("wav", ["data.path=nowhere.wav"], "'data.path': found 'nowhere.wav': no such file"),
        ("wav", ["data.kind=mp3"], "'data.kind': found mp3, expected wav, npy or sio"),
        ("wav", ["data.sample_rate=0"], "'data.sample_rate': found 0.0, expected a positive"),
        ("wav", ["data.start_s=-1"], "'data.start_s': found -1.0, expected a number from 0 up"),
        ("wav", ["data.duration_s=0"], "'data.duration_s': found 0.0, expected a positive number or null"),
        ("wav", ["data.truth=nowhere.csv"], "'data.truth': found '"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_what_does_not_fit_is_named(read, kind, overrides, message):
    with pytest.raises(InputError) as caught:
        read(kind, *overrides)
    assert message in str(caught.value)


def test_error_on_the_command_line(launch, files):
    outcome = launch("data=wav", f"data.path={files / 'array.npy'}")
    assert outcome.status == 1
    assert "key 'data.path': found '" in outcome.err
    assert not (outcome.directory / "metrics.json").exists()


def test_the_paper_as_configured(settings):
    chosen = settings("data=sio", "data.path=a.sio", small=False).data
    assert (chosen.kind, chosen.sample_rate, chosen.start_s, chosen.duration_s) == ("sio", 1500, 1800, 1200)
    assert (chosen.truth, chosen.truth_path) == (None, "tow")
    assert (chosen.static_copy.step, chosen.static_copy.gain_db) == (50, -3.0)
    length = chosen.window_length + 2 * chosen.hop
    assert 1 + (1200 * 1500 - length) // (3 * chosen.hop) == 292
