import math

import numpy as np
import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.data.signals.truth import read_truth

NAMES = ["range", "depth"]
TOW = "minute_since_start,range_to_array_km\n30,4.2\n31,4.1\n32,3.8\n"
PAIR = """time_s,a_range,a_depth,b_one_depth,b_one_range
0,100,10,30,
10,200,20,30,500
20,300,20,30,700
30,,20,30,700
"""


@pytest.fixture
def read(tmp_path):
    def read(text, times=(0.0,), names=NAMES, depth_m=None):
        (tmp_path / "truth.csv").write_text(text)
        times = torch.tensor(times, dtype=torch.float64)
        return read_truth(tmp_path / "truth.csv", names, times, depth_m)

    return read


def test_table_of_objects(read):
    truth = read(PAIR, (-1, 0, 5, 12.5, 20, 25, 30, 31))
    assert truth.dtype == torch.float64
    nan = math.nan
    a = [[nan] * 2, [100, 10], [150, 15], [225, 20], [300, 20], [nan, 20], [nan, 20], [nan] * 2]
    b = [[nan] * 2, [nan, 30], [nan, 30], [550, 30], [700, 30], [700, 30], [700, 30], [nan] * 2]
    np.testing.assert_allclose(truth, np.stack([a, b], 1), equal_nan=True)


def test_table_of_minutes_and_ranges(read):
    truth = read(TOW, (1799.0, 1800.0, 1830.0, 1905.0, 1921.0), depth_m=58.0)
    assert truth.shape == (5, 1, 2)
    expected = [[math.nan] * 2, [4200, 58], [4150, 58], [3875, 58], [math.nan] * 2]
    np.testing.assert_allclose(truth[:, 0], expected, equal_nan=True)


def test_table_of_a_spreadsheet(read):
    """It begins with a byte-order mark."""
    times = (5.0, 20.0)
    np.testing.assert_array_equal(read("\ufeff" + PAIR, times), read(PAIR, times))
    np.testing.assert_array_equal(read("\ufeff" + TOW, (1830.0,), depth_m=58.0)[0, 0], [4150.0, 58.0])


def test_one_coordinate(read):
    truth = read("time_s,a_bearing\n0,-10\n2,10\n", (0.5, 1.0), names=["bearing"])
    np.testing.assert_allclose(truth, [[[-5.0]], [[0.0]]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not enough values"),
        ("time_s,a_range,a_depth\n", "times that do not rise"),
        ("time_s,a_range,a_depth\n0,1,1\n0,2,2\n", "times that do not rise"),
        ("time_s,a_range,a_depth\n0,1,1\n,2,2\n", "times that do not rise"),
        ("time_s,a_range,a_depth\n0,1,far\n", "could not convert string to float: 'far'"),
        ("time_s,a_range,a_depth\n0,1\n", "rows of other lengths"),
        ("time_s,a_range\n0,1\n", "columns .*, expected time_s, then NAME_range and NAME_depth"),
        ("time_s,a_range,a_depth,b\n0,1,1,1\n", "columns .*'b'"),
        ("time_s,a_range,a_depth,a_depth\n0,1,1,1\n", "columns .*'a_depth', 'a_depth'"),
        ("seconds,a_range,a_depth\n0,1,1\n", "columns .'seconds'"),
        ("time_s\n0\n", "columns .'time_s'"),
        ("minute,range_m\n0,1\n", "columns .*, expected minute..., range...km"),
        ("minute,range_km,depth_m\n0,1,1\n", "columns .*, expected minute..., range...km"),
    ],
)
def test_table_that_does_not_fit(read, text, message):
    with pytest.raises(InputError, match=f"'data.truth': found .*{message}"):
        read(text, depth_m=58.0)


def test_ranges_without_a_depth(read):
    with pytest.raises(InputError, match=r"'data.truth_depth_m': found None, expected the depth"):
        read(TOW)


def test_ranges_for_other_coordinates(read):
    with pytest.raises(InputError, match=r"'data.truth': found ranges, expected \['bearing'\]"):
        read(TOW, names=["bearing"], depth_m=58.0)


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"'data.truth': found '.*nowhere.csv': no such file"):
        read_truth(tmp_path / "nowhere.csv", NAMES, torch.zeros(1))
