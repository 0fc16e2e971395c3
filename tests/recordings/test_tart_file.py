import numpy as np
import pytest
import torch
from oracles.tart import sky, write_sky

from recordings.tart_file import read_tart
from torchdt.core.errors import InputError


def test_covariance_is_that_of_plane_waves(tmp_path):
    """Phases of the receivers are taken out; what is left is the response, whatever the order of pairs."""
    arrays, vectors = sky()
    recording = read_tart(write_sky(tmp_path, arrays), average=1)
    place = torch.from_numpy(arrays["ant_enu_m"])
    wave = torch.exp(2j * torch.pi * 1.5e9 / 299792458.0 * (place @ torch.from_numpy(vectors[0, 0])))
    expected = 0.5 * wave[:, None] * wave.conj()[None] + 0.5 * torch.eye(len(place))
    torch.testing.assert_close(recording.covariance[0, 0, 0], expected)
    assert recording.step_s == pytest.approx(2.0)
    assert recording.freqs.tolist() == [1.5e9]


def test_steps_average_and_drop_the_rest(tmp_path):
    arrays, _ = sky(num_steps=5)
    path = write_sky(tmp_path, arrays)
    single, double = read_tart(path, average=1), read_tart(path, average=2, num_snapshots=7)
    assert double.covariance.shape[:3] == (1, 2, 1)
    torch.testing.assert_close(double.covariance[0, 1], single.covariance[0, 2:4].mean(0))
    assert double.step_s == pytest.approx(4.0)
    for recording, average in ((single, 1), (double, 2)):
        middle = [arrays["t_unix"][k : k + average].mean() for k in range(0, 5 - average + 1, average)]
        np.testing.assert_allclose(recording.times()[0], middle, rtol=0, atol=1e-5)
    assert double.num_snapshots == 7


def test_truth_is_what_shares_the_band_and_is_up(tmp_path):
    arrays, vectors = sky()
    truth = read_tart(write_sky(tmp_path, arrays), average=1).truth[0]
    assert truth.shape == (5, 2, 2)  # the third sends elsewhere, the fourth never rises
    np.testing.assert_allclose(truth[:, 0], vectors[0][:, :2], atol=1e-12)
    assert truth[:, 1].isnan().any(-1).tolist() == [
        True,
        True,
        False,
        False,
        False,
    ]  # 5.5, 8.5, 11.5 ...


@pytest.mark.parametrize("key", ["vis_raw", "baselines", "phase", "freq_hz", "sat_isL1"])
def test_missing_key_is_named(tmp_path, key):
    arrays, _ = sky()
    del arrays[key]
    with pytest.raises(InputError, match=f"'{key}': found nothing"):
        read_tart(write_sky(tmp_path, arrays))


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("phase", lambda a: a[:, 1:]),
        ("vis_raw", lambda a: a.real),
        ("baselines", lambda a: a + 1),
        ("sat_el_deg", lambda a: a[:, 1:]),
        ("ant_enu_m", lambda a: a[:, :2]),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, key, change):
    arrays, _ = sky()
    arrays[key] = change(arrays[key])
    with pytest.raises(InputError, match=rf"path '.*sky.npz': key '{key}'"):
        read_tart(write_sky(tmp_path, arrays), average=1)


def test_average_longer_than_the_recording(tmp_path):
    arrays, _ = sky()
    with pytest.raises(InputError, match="'average': found 6"):
        read_tart(write_sky(tmp_path, arrays), average=6)


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_tart(tmp_path / "none.npz")
