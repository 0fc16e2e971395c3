"""The signals of an array on a disk, read piece by piece."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from torchdt.core.errors import InputError


class Signal(NamedTuple):
    """Signals of M channels that stay in their file until they are asked for.

    Attributes:
        read: samples from the first index up to the second, `(M, samples)`, real, any unit of pressure.
        num_channels: M.
        num_samples: of each channel.
        sample_rate: Hz; None where the format does not say it.
    """

    read: Callable[[int, int], NDArray]
    num_channels: int
    num_samples: int
    sample_rate: float | None = None

    def blocks(self, start: int, stop: int, size: int = 1 << 16) -> Iterator[Tensor]:
        """Samples from `start` up to `stop` in pieces `(M, size)`, the last one shorter; float64."""
        for first in range(start, stop, size):
            yield torch.from_numpy(self.read(first, min(first + size, stop)).astype("f8", order="C"))


def unreadable(path: object, found: object, expected: object) -> InputError:
    """The error of a file that cannot be read, under the setting that names it."""
    return InputError.of_key("data.path", f"'{path}': {found}", expected)


def checked(path: object, signal: Signal, expected: object) -> Signal:
    """A signal of one or more channels and samples at a positive rate; InputError where it is not."""
    rate = signal.sample_rate
    for holds, found in (
        (signal.num_channels > 0, "no channels"),
        (signal.num_samples > 0, "no samples"),
        (rate is None or 0 < rate < math.inf, f"a sampling rate of {rate} Hz"),
    ):
        if not holds:
            raise unreadable(path, found, expected)
    return signal
