import struct

import numpy as np
import pytest
import torch
from scipy.io import wavfile

from torchdt.core.errors import InputError
from torchdt.data.signals.readers import open_npy, open_wav

WIDTHS = ["u1", "i2", "i4", "f4", "f8"]


def wav_of(bits, channels=1, tag=1, data=bytes(12)):
    frame = channels * bits // 8
    form = struct.pack("<4sIHHIIHH", b"fmt ", 16, tag, channels, 1500, 1500 * frame, frame, bits)
    body = b"WAVE" + form + struct.pack("<4sI", b"data", len(data)) + data
    return struct.pack("<4sI", b"RIFF", len(body)) + body


def contents(signal):
    return torch.cat(list(signal.blocks(0, signal.num_samples, 300)), -1).numpy()


@pytest.mark.parametrize("dtype", WIDTHS)
def test_wav(tmp_path, samples, dtype):
    samples = (samples >> 8).astype(dtype) if dtype != "u1" else ((samples >> 8) + 128).astype("u1")
    wavfile.write(tmp_path / "a.wav", 1500, samples.T)
    signal = open_wav(tmp_path / "a.wav")
    assert signal[1:] == (3, 1000, 1500.0)
    np.testing.assert_array_equal(contents(signal), samples.astype("f8") - (128 if dtype == "u1" else 0))


def test_wav_of_one_channel(tmp_path, samples):
    wavfile.write(tmp_path / "a.wav", 96000, samples[0])
    signal = open_wav(tmp_path / "a.wav")
    assert signal[1:] == (1, 1000, 96000.0)
    np.testing.assert_array_equal(contents(signal), samples[:1])


@pytest.fixture
def wav24(tmp_path):
    """Two channels of 24 bits, the largest and the smallest number among them, and the file."""
    samples = np.random.default_rng(1).integers(-(2**23), 2**23, (2, 500), dtype="<i4")
    samples[:, :4] = [[-(2**23), 2**23 - 1, -1, 0], [1, 255, 256, -256]]
    lower = samples.T.reshape(-1, 1).copy().view("u1")[:, :3]
    (tmp_path / "a.wav").write_bytes(wav_of(24, channels=2, data=lower.tobytes()))
    return samples, tmp_path / "a.wav"


def test_wav_of_24_bits(wav24):
    samples, path = wav24
    signal = open_wav(path)
    assert signal[1:] == (2, 500, 1500.0)
    np.testing.assert_array_equal(contents(signal), samples)


@pytest.mark.parametrize("missing", [1, 3, 6, 600])
def test_wav_of_24_bits_cut_short(wav24, missing):
    _, path = wav24
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(InputError, match=r"'data.path': found '.*a.wav': .*, expected a complete .wav"):
        open_wav(path)


@pytest.mark.parametrize("dtype", [*WIDTHS, ">i2", ">f4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy(tmp_path, samples, dtype, order):
    samples = np.asarray((samples >> 8).astype("u1" if dtype == "u1" else "i2").astype(dtype), order=order)
    np.save(tmp_path / "a.npy", samples)
    signal = open_npy(tmp_path / "a.npy")
    assert signal[1:] == (3, 1000, None)
    np.testing.assert_array_equal(contents(signal), samples)


@pytest.mark.parametrize("kept", [0, 3, 11, 30, 43, 2000, -1])
def test_wav_cut_short(write, samples, kept):
    path = write("wav", samples)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"'data.path': found '.*array.wav': .*, expected a complete .wav"):
        open_wav(path)


@pytest.mark.parametrize("kept", [0, 5, 60, 2000, -1])
def test_npy_cut_short(write, samples, kept):
    path = write("npy", samples)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"'data.path': found '.*array.npy': .*, expected a complete .npy"):
        open_npy(path)


@pytest.mark.parametrize("shape", [(0,), (0, 3)])
def test_wav_without_samples(tmp_path, shape):
    wavfile.write(tmp_path / "a.wav", 1500, np.zeros(shape, "i2"))
    with pytest.raises(InputError, match=r"a.wav': no samples, expected a complete .wav"):
        open_wav(tmp_path / "a.wav")


def test_wav_without_a_rate(tmp_path, samples):
    wavfile.write(tmp_path / "a.wav", 0, samples.T)
    with pytest.raises(InputError, match=r"a.wav': a sampling rate of 0.0 Hz, expected a complete .wav"):
        open_wav(tmp_path / "a.wav")


@pytest.mark.parametrize(("shape", "found"), [((3, 0), "no samples"), ((0, 3), "no channels")])
def test_npy_without_content(tmp_path, shape, found):
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(InputError, match=f"a.npy': {found}, expected a complete .npy"):
        open_npy(tmp_path / "a.npy")


def test_the_crafted_wav_is_one(tmp_path):
    (tmp_path / "a.wav").write_bytes(wav_of(16))
    assert open_wav(tmp_path / "a.wav").num_samples == 6


@pytest.mark.parametrize(
    "content",
    [b"not a recording", wav_of(40), wav_of(16, channels=0), wav_of(16, channels=4), wav_of(8, 1, 7)],
)
def test_wav_of_another_kind(tmp_path, content):
    (tmp_path / "a.wav").write_bytes(content)
    with pytest.raises(InputError, match=r"'data.path': found .*a.wav.*8, 16, 24, 32 or 64 bits"):
        open_wav(tmp_path / "a.wav")


@pytest.mark.parametrize(
    ("array", "found"),
    [
        (np.zeros(5), r"float64 \(5,\)"),
        (np.zeros((2, 5), complex), r"complex128 \(2, 5\)"),
        (np.array([[{}]]), "Array can't be memory-mapped: Python objects"),
    ],
)
def test_npy_of_another_kind(tmp_path, array, found):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(InputError, match=rf"'data.path': found '.*a.npy': {found}"):
        open_npy(tmp_path / "a.npy")


def test_archive_under_the_name_of_an_array(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.zeros((2, 5)))
    with pytest.raises(InputError, match=r"found '.*a.npz': an archive of arrays"):
        open_npy(tmp_path / "a.npz")


@pytest.mark.parametrize("reader", [open_wav, open_npy])
def test_no_such_file(tmp_path, reader):
    with pytest.raises(InputError, match=r"'data.path': found '.*nowhere': no such file"):
        reader(tmp_path / "nowhere")
