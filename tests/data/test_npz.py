import io
import logging
import pickle
import zipfile

import numpy as np
import pytest
import torch
from oracles.arrays import changed

from torchdt.core.errors import InputError
from torchdt.data import npz
from torchdt.data.npz import read_npz, write_npz
from torchdt.data.recording import Recording, validate

B, K, I, J, M, L = 2, 5, 3, 4, 6, 2  # noqa: E741
NAN = complex(np.nan, np.nan)


def complex_normal(*shape, dtype=np.complex64):
    rng = np.random.default_rng(0)
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype)


def sample_covariance(*shape):
    z = complex_normal(*shape, J, M, dtype=np.complex128)
    return np.einsum("...jm,...jn->...mn", z, z.conj()) / J


def snapshot_file(**changes):
    given = {
        "snapshots": complex_normal(K, I, J, M),
        "step_s": 4.096,
        "freqs": np.array([49, 79, 112]),
        "element_depths": np.linspace(94.0, 212.0, M),
        "sensor_positions": np.zeros((M, 3)),
        "truth": np.full((K, L, 2), [3000.0, 54.0]),
    }
    return {key: value for key, value in (given | changes).items() if value is not None}


def covariance_file(**changes):
    given = {"covariance": sample_covariance(K, I), "num_snapshots": J, "step_s": 4.096}
    return {key: value for key, value in (given | changes).items() if value is not None}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "scene.npz"


def read(path, arrays):
    np.savez(path, **arrays)
    return read_npz(path)


def test_reads_one_recording(path):
    arrays = snapshot_file()
    recording = read(path, arrays)
    assert recording.snapshots.shape == (1, K, I, J, M)
    assert recording.snapshots.dtype == torch.complex64
    assert recording.name == "scene"
    assert recording.step_s == 4.096
    assert recording.freqs.dtype == torch.float64
    assert recording.truth.shape == (1, K, L, 2)
    sizes = recording.batch_size, recording.num_steps, recording.num_tones, recording.num_sensors
    assert sizes == (1, K, I, M)
    assert recording.start_s.tolist() == [0.0]
    np.testing.assert_allclose(recording.times(), [4.096 * (np.arange(K) + 0.5)])
    np.testing.assert_array_equal(recording.snapshots[0], arrays["snapshots"])


@pytest.mark.parametrize(("start_s", "found"), [(-7.5, [-7.5, -7.5]), ([1.0, 2.0], [1.0, 2.0])])
def test_time_of_the_first_sample(path, tmp_path, start_s, found):
    """One number for all recordings, as the file has it, or one for each; written as it was read."""
    recording = read(
        path, snapshot_file(snapshots=complex_normal(B, K, I, J, M), truth=None, start_s=start_s)
    )
    np.testing.assert_allclose(recording.times(), np.array(found)[:, None] + 4.096 * (np.arange(K) + 0.5))
    write_npz(tmp_path / "again.npz", recording)
    with np.load(tmp_path / "again.npz") as again:
        assert again["start_s"].tolist() == start_s


def test_steps_that_share_samples(path):
    """The middle of the samples that a step is made of, which overlap those of the next."""
    recording = read(path, snapshot_file(start_s=100.0, span_s=5.0))
    np.testing.assert_allclose(recording.times()[0], 102.5 + 4.096 * np.arange(K))


def test_reads_a_batch(path):
    truth = np.zeros((B, K, L, 2), dtype=np.float32)
    recording = read(path, snapshot_file(snapshots=complex_normal(B, K, I, J, M), truth=truth))
    assert recording.snapshots.shape == (B, K, I, J, M)
    assert recording.truth.shape == (B, K, L, 2)


def test_truth_mask(path):
    truth = np.zeros((K, L, 2))
    truth[1, 0] = np.nan
    truth[2, 1, 0] = np.nan  # a position that is known in part cannot be scored
    mask = read(path, snapshot_file(truth=truth)).truth_mask
    assert (~mask).nonzero().tolist() == [[0, 1, 0], [0, 2, 1]]
    assert read(path, snapshot_file(truth=None)).truth_mask is None


def test_truth_may_hold_no_object(path):
    assert read(path, snapshot_file(truth=np.zeros((K, 0, 2)))).truth_mask.shape == (1, K, 0)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize("make", [snapshot_file, covariance_file])
def test_round_trip(path, tmp_path, make, dtype):
    key = "snapshots" if make is snapshot_file else "covariance"
    first = read(path, make(**{key: make()[key].astype(dtype)}))
    again = tmp_path / "again.data"
    write_npz(again, first)
    second = read_npz(again)
    assert getattr(second, key).numpy().dtype == dtype
    assert [item.name for item in tmp_path.iterdir() if "again" in item.name] == ["again.data"]
    for name in vars(first).keys() - {"name"}:
        a, b = getattr(first, name), getattr(second, name)
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b, name


@pytest.mark.parametrize("convert", [lambda a: a.astype(a.dtype.newbyteorder(">")), np.asfortranarray])
def test_any_memory_layout(path, convert):
    arrays = snapshot_file()
    recording = read(path, snapshot_file(snapshots=convert(arrays["snapshots"])))
    np.testing.assert_array_equal(recording.snapshots[0], arrays["snapshots"])


def test_failed_write_keeps_the_old_file(path, monkeypatch):
    recording = read(path, snapshot_file())
    before = path.read_bytes()

    def fail(file, **_):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="disk full"):
        write_npz(path, recording)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_missing_snapshots_are_no_error(path):
    z = complex_normal(K, I, J, M)
    z[1, 2, 3] = NAN  # one snapshot
    z[..., 4] = NAN  # one channel
    z[0, 0, 0, 0] = complex(np.nan, 1.0)
    summary = read(path, snapshot_file(snapshots=z)).missing_summary()
    assert summary.num_missing == K * I * J + (M - 1) + 1
    assert summary.num_entries == K * I * J * M
    assert summary.dead_channels.tolist() == [[m == 4 for m in range(M)]]


def test_missing_covariance_is_no_error(path):
    c = sample_covariance(K, I)
    c[..., 2, :] = c[..., :, 2] = NAN  # a dead channel
    c[1, 0, 3, 4] = c[1, 0, 4, 3] = NAN  # one pair
    c[2] = NAN  # a step without data
    summary = read(path, covariance_file(covariance=c)).missing_summary()
    assert summary.num_missing == ((K - 1) * (2 * M - 1) + M * M) * I + 2
    assert summary.dead_channels.tolist() == [[m == 2 for m in range(M)]]


def test_gaps_do_not_make_a_covariance_indefinite(path):
    """One object without noise: with any entry set to zero a rank-one matrix gets negative eigenvalues."""
    c = np.ones((K, I, M, M), complex)
    c[0, 0, 3, 4] = c[0, 0, 4, 3] = NAN
    c[1, 1, 2, 2] = NAN
    assert read(path, covariance_file(covariance=c)).missing_summary().num_missing == 3


def test_any_scale_is_accepted(path):
    for scale in (1e-12, 1e12):
        read(path, covariance_file(covariance=sample_covariance(K, I) * scale))


@pytest.mark.parametrize("step", [4.096, torch.tensor(4.096, dtype=torch.float64)])
def test_validate_takes_numbers_and_tensors(step):
    recording = validate(snapshots=torch.zeros(K, I, J, M, dtype=torch.complex64), step_s=step)
    assert recording.step_s == 4.096


COVARIANCE = sample_covariance(K, I)
BAD_SNAPSHOT_FILES = [
    ({"snapshots": None}, "key 'snapshots': found neither .*, expected one of the two"),
    ({"covariance": COVARIANCE}, "key 'covariance': found snapshots as well, expected either"),
    ({"snapshots": np.zeros((K, I, J, M))}, r"key 'snapshots': found torch.float64, expected complex"),
    (
        {"snapshots": np.zeros((K, I, M), complex)},
        r"key 'snapshots': found shape \(5, 3, 6\), expected .*J, M",
    ),
    ({"snapshots": np.zeros((K, I, 0, M), complex)}, r"key 'snapshots': found shape \(5, 3, 0, 6\)"),
    (
        {"snapshots": changed(complex_normal(K, I, J, M), (1, 2, 3, 4), np.inf)},
        r"key 'snapshots': found 1 infinite values, the first at \(1, 2, 3, 4\), expected none",
    ),
    ({"snapshots": np.zeros((K, I, J, M), object)}, "key 'snapshots': found .*pickle.*, expected a numeric"),
    ({"snapshots": np.array("text")}, "key 'snapshots': found <U4, expected a numeric array"),
    ({"num_snapshots": J + 1}, "key 'num_snapshots': found 5, expected 4, as in snapshots"),
    ({"step_s": None}, "key 'step_s': found nothing, expected the seconds"),
    ({"step_s": 0.0}, "key 'step_s': found 0.0, expected .*above zero"),
    ({"step_s": -1}, "key 'step_s': found -1, expected .*above zero"),
    ({"step_s": np.nan}, "key 'step_s': found nan, expected .*above zero"),
    ({"step_s": np.inf}, "key 'step_s': found inf, expected .*above zero"),
    ({"step_s": [1.0, 2.0]}, r"key 'step_s': found shape \(2,\), expected a scalar"),
    ({"step_s": 1j}, "key 'step_s': found torch.complex128, expected a number"),
    ({"start_s": np.nan}, "key 'start_s': found a value that is NaN or infinite, expected finite"),
    ({"start_s": [1.0, 2.0]}, r"key 'start_s': found shape \(2,\), expected \(1,\): s, one number or one"),
    ({"start_s": 1j}, "key 'start_s': found torch.complex128, expected real"),
    ({"span_s": -1.0}, "key 'span_s': found -1.0, expected .*from zero up"),
    ({"freqs": np.ones(4)}, r"key 'freqs': found shape \(4,\), expected \(3,\)"),
    ({"freqs": np.array([1.0, 0, 2])}, "key 'freqs': found 0.0, expected .*above zero"),
    ({"freqs": np.array([1.0, np.nan, 2])}, "key 'freqs': found .*NaN or infinite, expected finite"),
    ({"freqs": np.ones(3, complex)}, "key 'freqs': found torch.complex128, expected real"),
    ({"element_depths": np.ones(M - 1)}, r"key 'element_depths': found shape \(5,\), expected \(6,\)"),
    ({"element_depths": np.full(M, np.inf)}, "key 'element_depths': found .*infinite, expected finite"),
    (
        {"sensor_positions": np.ones((M, 2))},
        r"key 'sensor_positions': found shape \(6, 2\), expected \(6, 3\)",
    ),
    ({"sensor_positions": np.full((M, 3), np.nan)}, "key 'sensor_positions': found .*NaN.*, expected finite"),
    ({"truth": np.zeros((K + 2, L, 2))}, r"key 'truth': found 7 steps \(shape .*\), expected 5 steps"),
    ({"truth": np.zeros((B, K, L, 2))}, r"key 'truth': found 2 runs \(shape .*\), expected 1 runs"),
    ({"truth": np.zeros((K, 2))}, r"key 'truth': found shape \(5, 2\), expected .*K, L, d"),
    ({"truth": np.zeros((K, L, 0))}, r"key 'truth': found shape \(5, 2, 0\), expected .*d above zero"),
    ({"truth": np.full((K, L, 2), np.inf)}, "key 'truth': found 20 infinite values.*, expected none"),
    ({"truth": np.zeros((K, L, 2), complex)}, "key 'truth': found torch.complex128, expected real"),
]
BAD_COVARIANCE_FILES = [
    ({"num_snapshots": None}, "key 'num_snapshots': found nothing, expected the number"),
    ({"num_snapshots": 0}, "key 'num_snapshots': found 0, expected .*one"),
    ({"num_snapshots": np.inf}, "key 'num_snapshots': found inf, expected .*one"),
    ({"num_snapshots": [3, 3]}, r"key 'num_snapshots': found shape \(2,\), expected a scalar"),
    ({"covariance": np.ones((K, I, M, M))}, "key 'covariance': found torch.float64, expected complex"),
    ({"covariance": COVARIANCE[..., :-1]}, r"key 'covariance': found shape \(5, 3, 6, 5\), expected .*M, M"),
    ({"covariance": COVARIANCE[0]}, r"key 'covariance': found shape \(3, 6, 6\), expected .*K, I, M, M"),
    (
        {"covariance": changed(COVARIANCE, (3, 1, 0, 1), 9.0)},
        r"key 'covariance': found .*not Hermitian \(run 0, step 3, tone 1; 1 in all\), expected Hermitian",
    ),
    (
        {"covariance": changed(COVARIANCE, (3, 1, 0, 0), COVARIANCE[3, 1, 0, 0] + 1j)},
        r"key 'covariance': found .*not Hermitian",
    ),
    (
        {"covariance": COVARIANCE - 10 * np.eye(M)},
        "key 'covariance': found .*negative eigenvalue .* 15 in all.*, expected positive semidefinite",
    ),
    (
        {"covariance": changed(COVARIANCE - 10 * np.eye(M), np.s_[..., 0, :], NAN).swapaxes(-1, -2)},
        r"key 'covariance': found NaN at \[m, n\] but not at \[n, m\]",
    ),
    (
        {"covariance": changed(COVARIANCE, (0, 0, 1, 1), -np.inf)},
        "key 'covariance': found 1 infinite values",
    ),
]


@pytest.mark.parametrize(
    ("file", "changes", "message"),
    [(snapshot_file, *case) for case in BAD_SNAPSHOT_FILES]
    + [(covariance_file, *case) for case in BAD_COVARIANCE_FILES],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_bad_file(path, file, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        read(path, file(**changes))
    assert str(path) in str(caught.value)


def with_header(path, shape, content=b""):
    """A file whose snapshots have a header of complex numbers of some shape, whatever follows."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"shape": shape, "fortran_order": False, "descr": "<c16"})
    np.savez(path, step_s=1.0)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("snapshots.npy", header.getvalue() + content)


def test_a_header_that_claims_more_than_there_is(path):
    with_header(path, (600_000, 1000, 1, 1000), bytes(160))
    with pytest.raises(
        InputError, match="'snapshots': found a header of 9600000000000 bytes, expected 160, as"
    ):
        read_npz(path)


def test_more_than_the_memory_holds_is_not_unpacked(path, monkeypatch):
    """Zeros, of which a file of a few kilobytes holds a megabyte."""
    with_header(path, (100, 5, 5, 25), bytes(1_000_000))
    monkeypatch.setattr(npz, "free_memory_gb", lambda device: 0.0019)
    with pytest.raises(
        InputError, match="'snapshots': found 1000000 bytes, expected at most 950000, half of"
    ):
        read_npz(path)
    monkeypatch.setattr(npz, "free_memory_gb", lambda device: 0.0021)
    assert read_npz(path).num_steps == 100


def test_a_single_array_is_not_read(tmp_path):
    """Not even its header, which may claim anything."""
    with (tmp_path / "a.npy").open("wb") as file:
        header = {"shape": (600_000, 1000, 1, 1000), "fortran_order": False, "descr": "<c16"}
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(InputError, match=r"found a single array \(.npy\), expected a complete .npz"):
        read_npz(tmp_path / "a.npy")


@pytest.mark.skipif(np.dtype(np.clongdouble).itemsize == 16, reason="no such type on this platform")
def test_more_than_double_precision(path):
    with pytest.raises(InputError, match=r"key 'snapshots': found complex\d+, expected double precision"):
        read(path, snapshot_file(snapshots=np.zeros((K, I, J, M), np.clongdouble)))


def test_negative_power_beside_a_missing_channel(path):
    c = sample_covariance(K, I)
    c[..., 2, :] = c[..., :, 2] = NAN
    c[4, 2, 0, 0] = -1.0
    with pytest.raises(InputError, match=r"negative eigenvalue \(run 0, step 4, tone 2; 1 in all\)"):
        read(path, covariance_file(covariance=c))


def test_rounding_is_no_error(path):
    c = sample_covariance(K, I)  # rank J < M: some eigenvalues are zero
    noise = complex_normal(K, I, M, M) * 1e-6 * np.abs(c).max((-1, -2), keepdims=True)
    read(path, covariance_file(covariance=(c + noise).astype(np.complex64)))


def test_unknown_keys_are_logged(path, caplog):
    with caplog.at_level(logging.WARNING):
        read(path, snapshot_file(comment=np.array("hello"), gain=np.ones(2)))
    assert "comment, gain" in caplog.text
    assert str(path) in caplog.text


def test_known_keys_log_nothing(path, caplog):
    read(path, snapshot_file())
    assert caplog.text == ""


def test_paths_that_are_no_npz(tmp_path):
    single = tmp_path / "single.npy"
    np.save(single, np.zeros(3))
    pickled = tmp_path / "pickled.npz"
    pickled.write_bytes(pickle.dumps({"snapshots": 1}))
    empty = tmp_path / "empty.npz"
    empty.touch()
    cases = {
        tmp_path / "absent.npz": "no such file",
        tmp_path: "a folder",
        single: "a single array",
        pickled: "a file of another kind",
        empty: "a file of another kind",
    }
    for path, found in cases.items():
        with pytest.raises(InputError, match=f"found {found}.*, expected a complete .npz file") as caught:
            read_npz(path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9, 0.999])
def test_truncated_file(path, kept):
    np.savez_compressed(path, **snapshot_file())
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(InputError, match=str(path)):
        read_npz(path)


def test_damaged_member(path):
    np.savez(path, **snapshot_file())
    data = bytearray(path.read_bytes())
    data[600:610] = bytes(10)
    path.write_bytes(data)
    with pytest.raises(InputError, match="key 'snapshots': found an array that cannot be read"):
        read_npz(path)


def test_errors_survive_another_process():
    error = InputError.of_key("truth", "7 steps", "5 steps")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) == "key 'truth': found 7 steps, expected 5 steps"


def test_recording_is_frozen(path):
    recording = read(path, snapshot_file())
    assert isinstance(recording, Recording)
    with pytest.raises(AttributeError):
        recording.step_s = 1.0
