import math

import numpy as np
import pytest
import torch
from oracles.scripts import track_settings

import recordings.directions  # noqa: F401 - data=directions
from recordings.directions import in_coordinates
from torchdt.app.build import build_recording
from torchdt.core.errors import InputError

SOUTH_EAST = [math.sqrt(0.5), -math.sqrt(0.5)]


def write(folder, **changes):
    truth = np.full((6, 2, 2), np.nan)
    truth[:, 0] = SOUTH_EAST
    arrays = {"snapshots": np.arange(6 * 3 * 4).reshape(6, 1, 3, 4) + 1j, "step_s": 0.5, "truth": truth}
    np.savez(folder / "sound.npz", **(arrays | changes))
    return folder / "sound.npz"


def read(path, *overrides):
    chosen = ("scenario=drone", "data=directions", f"data.path={path}", *overrides)
    return build_recording(track_settings(*chosen, small=False))


def test_truth_is_in_the_coordinates_of_the_field():
    cosines = torch.tensor([SOUTH_EAST, [0.5, 0.0], [math.nan, math.nan]], dtype=torch.float64)
    bearing = in_coordinates(cosines, "bearing")
    torch.testing.assert_close(bearing[:2, 0], torch.tensor([135.0, 90.0], dtype=torch.float64))
    torch.testing.assert_close(
        in_coordinates(cosines, "azimuth_elevation")[1], torch.tensor([90.0, 60.0], dtype=torch.float64)
    )
    torch.testing.assert_close(in_coordinates(cosines, "direction_cosines"), cosines, equal_nan=True)
    assert bearing[2].isnan().all()


def test_a_file_and_some_of_its_steps(tmp_path):
    path = write(tmp_path)
    whole, part = read(path), read(path, "data.first_step=2", "data.num_steps=3")
    assert whole.truth.shape == (1, 6, 2, 1)
    torch.testing.assert_close(part.snapshots, whole.snapshots[:, 2:5])
    torch.testing.assert_close(part.times(), whole.times()[:, 2:5])
    assert part.truth.shape == (1, 3, 2, 1)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("data.first_step=6",), "'data.num_steps': found steps from 6 to 6"),
        (("data.num_steps=7",), "'data.num_steps': found steps from 0 to 7"),
        (("data.path=null",), "'data.path': found None"),
        (("field.coordinates=bow",), "'field.coordinates': found bow"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path, overrides, words):
    with pytest.raises(InputError, match=words):
        read(write(tmp_path), *overrides)


def test_truth_of_other_coordinates_is_named(tmp_path):
    with pytest.raises(InputError, match="'truth': found 1 coordinates"):
        read(write(tmp_path, truth=np.zeros((6, 1, 1))))
