"""A field's configuration names one function, and only that one is called."""

import pickle
import re

import pytest
import torch

from torchdt.app.targets import build_field
from torchdt.core.errors import InputError

LINE = {
    "_target_": "torchdt.field.build.line_array",
    "freqs": [100.0],
    "sensor_positions": [0.0, 2.0],
    "wave_speed": 1500.0,
}
CALLS = []


def note(*_, **__):
    CALLS.append(1)
    return {"tilt_deg": 0.0}


TARGET = {"_target_": f"{__name__}.note"}


@pytest.fixture(autouse=True)
def _forget():
    CALLS.clear()


def test_the_top_is_built():
    assert build_field(LINE, torch.float64, "cpu").num_sensors == 2


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"wave_speed": TARGET}, "field.wave_speed._target_"),
        ({"draw": TARGET}, "field.draw._target_"),
        ({"draw": {"eof_coefficients": [TARGET]}}, "field.draw.eof_coefficients[0]._target_"),
        ({"freqs": [[1.0, {"a": TARGET}]]}, "field.freqs[0][1].a._target_"),
        ({"wave_speed": TARGET, "_recursive_": True}, "field.wave_speed._target_"),
    ],
)
def test_targets_deeper_down_are_refused(changes, key):
    with pytest.raises(
        InputError, match=re.escape(f"key '{key}': found {TARGET['_target_']}, expected none")
    ):
        build_field(LINE | changes, torch.float64, "cpu")
    assert not CALLS


def test_nothing_is_loaded_from_a_pickle(tmp_path):
    class Bomb:
        def __reduce__(self):
            return note, ()

    path = tmp_path / "array.pt"
    path.write_bytes(pickle.dumps(Bomb()))
    load = {"_target_": "torch.load", "f": str(path), "weights_only": False}
    with pytest.raises(InputError, match="expected none but field"):
        build_field(LINE | {"freqs": load}, torch.float64, "cpu")
    assert not CALLS
