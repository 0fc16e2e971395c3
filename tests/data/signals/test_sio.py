import numpy as np
import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.data.signals.sio import open_sio


@pytest.mark.parametrize("order", "><")
@pytest.mark.parametrize("dtype", ["i2", "f4"])
@pytest.mark.parametrize("record_bytes", [128, 512, 4096])
@pytest.mark.parametrize("size", [7, 256, 1000])
def test_what_was_written_is_read(write, samples, order, dtype, record_bytes, size):
    path = write("sio", samples.astype(dtype), record_bytes=record_bytes, order=order)
    signal = open_sio(path)
    assert signal[1:] == (3, 1000, None)
    np.testing.assert_array_equal(torch.cat(list(signal.blocks(0, 1000, size)), -1), samples)


def test_a_part_is_read(write, samples):
    signal = open_sio(write("sio", samples))
    for start, stop in ((0, 1), (255, 257), (256, 512), (999, 1000)):
        np.testing.assert_array_equal(signal.read(start, stop), samples[:, start:stop])


@pytest.mark.parametrize("kept", [0, 31, 127, 512, 3000, -1])
def test_cut_short(write, samples, kept):
    path = write("sio", samples)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(
        InputError, match=r"'data.path': found '.*array.sio': .*, expected .*a complete SIO file"
    ):
        open_sio(path)


def test_the_length_that_is_missing_is_named(write, samples):
    path = write("sio", samples)
    path.write_bytes(path.read_bytes()[:-1])
    size = 512 * (1 + 3 * 4)
    with pytest.raises(InputError, match=f"{size - 1} bytes, expected {size}"):
        open_sio(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"mark": 32678}, "found '.*': a header without the byte-order mark 32677"),
        ({"channels": 0}, "0 channels in the header, expected one or more"),
        ({"channels": -3}, "-3 channels in the header"),
        ({"channels": 4}, "6656 bytes, expected 8704"),
        ({"samples": 0}, "0 samples per channel in the header, expected one or more"),
        ({"samples": 1025}, "6656 bytes, expected 8192"),
        ({"sample_bytes": 3}, "3 bytes per sample in the header, expected 2 or 4"),
        ({"record_bytes": 64}, "64 bytes per record in the header, expected 128 or more"),
        ({"record_bytes": 511}, "511 bytes per record, expected a multiple of 2"),
    ],
)
def test_header_that_contradicts_itself(write, samples, header, message):
    """The file has 13 records of 512 bytes."""
    with pytest.raises(InputError, match=message):
        open_sio(write("sio", samples, header=header))


def test_no_such_file(tmp_path):
    with pytest.raises(InputError, match=r"'data.path': found '.*nowhere': no such file"):
        open_sio(tmp_path / "nowhere")
