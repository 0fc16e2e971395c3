import tracemalloc

import numpy as np
import pytest
import torch

from torchdt.app.signals import READERS
from torchdt.data.signals.signal import Signal


def test_blocks_join_up_and_are_of_the_wanted_size():
    data = np.arange(30, dtype=">i2").reshape(3, 10)
    signal = Signal(lambda start, stop: data[:, start:stop], 3, 10)
    blocks = list(signal.blocks(1, 9, 3))
    assert [block.shape for block in blocks] == [(3, 3), (3, 3), (3, 2)]
    assert {block.dtype for block in blocks} == {torch.float64}
    np.testing.assert_array_equal(torch.cat(blocks, -1), data[:, 1:9])


def test_only_what_is_asked_for_is_read():
    calls = []

    def read(start, stop):
        calls.append((start, stop))
        return np.zeros((2, stop - start))

    next(iter(Signal(read, 2, 10**12).blocks(5, 10**12, 100)))
    assert calls == [(5, 105)]


@pytest.mark.parametrize("kind", ["wav", "npy", "sio"])
def test_a_file_is_never_in_memory_as_a_whole(write, kind):
    """Four channels of 2e6 values of 16 bits are 16 MB; blocks of 4096 values in double precision 131 kB."""
    path = write(kind, np.ones((4, 2_000_000), "i2"))
    tracemalloc.start()
    signal = READERS[kind](path)
    total = sum(int(block.sum()) for block in signal.blocks(0, signal.num_samples, 4096))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert total == 8_000_000
    assert peak < 2e6
