"""Reader of SIO files, the format of the SWellEx-96 recordings.

The layout is that of `sioread.m` (Marine Physical Laboratory, UC San Diego; A. Thode, G. Edelmann, J. Murray,
D. Ensberg, J. Sarkar). A file is a row of records of equal length. The first is the header, which begins with
eight 32-bit integers:

    number of the file, number of records, bytes per record, channels, bytes per sample,
    0 for integers or 1 for reals, samples per channel, 32677

and goes on with the name of the file (24 characters) and a comment (72). The last integer tells the byte
order. Then come the data, one record per channel in turn. Samples of two bytes are integers, those of four
are reals. The header knows no sampling rate.
"""

import math
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from torchdt.core.files import regular_file
from torchdt.data.signals.signal import Signal, unreadable

EXPECTED = "a complete SIO file"
BYTE_ORDER_MARK = 32677
HEADER_BYTES = 128
SAMPLE_TYPES = {2: "i2", 4: "f4"}


def open_sio(path: Path) -> Signal:
    """An SIO file; channels are sensors, in their order.

    Raises:
        InputError: no such file, not an SIO file, a header that contradicts itself, or a file cut short.
    """
    try:
        with regular_file(path, EXPECTED, unreadable).open("rb") as file:
            head = file.read(HEADER_BYTES)
        size = path.stat().st_size
    except OSError as error:
        raise unreadable(path, (error.strerror or str(error)).lower(), EXPECTED) from error
    order = _byte_order(path, head)
    _, _, record_bytes, channels, sample_bytes, _, samples, _ = struct.unpack_from(f"{order}8i", head)
    for name, found, holds, expected in (
        ("channels", channels, channels > 0, "one or more"),
        ("samples per channel", samples, samples > 0, "one or more"),
        ("bytes per sample", sample_bytes, sample_bytes in SAMPLE_TYPES, "2 or 4"),
        ("bytes per record", record_bytes, record_bytes >= HEADER_BYTES, f"{HEADER_BYTES} or more"),
    ):
        if not holds:
            raise unreadable(path, f"{found} {name} in the header", expected)
    per_record, rest = divmod(record_bytes, sample_bytes)
    if rest:
        raise unreadable(path, f"{record_bytes} bytes per record", f"a multiple of {sample_bytes}")
    rounds = math.ceil(samples / per_record)
    needed = record_bytes * (1 + rounds * channels)
    if size < needed:
        raise unreadable(path, f"{size} bytes", f"{needed}, from the header of {EXPECTED}")
    dtype, shape = np.dtype(f"{order}{SAMPLE_TYPES[sample_bytes]}"), (rounds, channels, per_record)
    records = np.memmap(path, dtype, "r", offset=record_bytes, shape=shape)

    def read(start: int, stop: int) -> NDArray:
        first, last = start // per_record, math.ceil(stop / per_record)
        whole = records[first:last].swapaxes(0, 1).reshape(channels, -1)
        return whole[:, start - first * per_record : stop - first * per_record]

    return Signal(read, channels, samples)


def _byte_order(path: Path, head: bytes) -> str:
    if len(head) == HEADER_BYTES:
        for order in "><":
            if struct.unpack_from(f"{order}i", head, 28) == (BYTE_ORDER_MARK,):
                return order
    raise unreadable(path, f"a header without the byte-order mark {BYTE_ORDER_MARK}", EXPECTED)
