"""Readers of `.wav` and `.npy` files, mapped into memory and not loaded; only 24 bits cannot be mapped."""

import math
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from torchdt.core.files import regular_file
from torchdt.data.signals.signal import Signal, checked, unreadable

WAV = "a complete .wav file of 8, 16, 24, 32 or 64 bits per sample"
NPY = "a complete .npy file of real numbers of shape (channels, samples)"


def open_wav(path: Path) -> Signal:
    """A `.wav` file; channels are sensors, in their order.

    Raises:
        InputError: no such file, not a complete `.wav`, or of another width.
    """
    path = regular_file(path, WAV, unreadable)
    try:
        sample_rate, samples = _mapped_or_loaded(path)
    except Exception as error:  # damaged headers make the parser fail in many ways, NameError among them
        raise unreadable(path, _reason(error), WAV) from error
    channels = samples.reshape(len(samples), math.prod(samples.shape[1:])).T
    silence = 128 if samples.dtype == np.uint8 else 0  # widths up to 8 bits are unsigned

    def read(start: int, stop: int) -> NDArray:
        return channels[:, start:stop].astype("f8") - silence

    return checked(path, Signal(read, channels.shape[0], channels.shape[1], float(sample_rate)), WAV)


def _mapped_or_loaded(path: Path) -> tuple[int, NDArray]:
    """Sampling rate and samples, whole numbers in units of the last bit."""
    try:
        return wavfile.read(path, mmap=True)
    except ValueError as error:
        if "3-byte" not in str(error):
            raise
    with warnings.catch_warnings():
        # Mapping refuses a file that ends before its data do; loading takes what there is.
        warnings.filterwarnings("error", "Reached EOF prematurely", wavfile.WavFileWarning)
        sample_rate, samples = wavfile.read(path)
    return sample_rate, samples >> 8  # SciPy puts the 24 bits to the top of 32


def open_npy(path: Path) -> Signal:
    """A `.npy` file with one real array `(channels, samples)`.

    Raises:
        InputError: no such file, not a complete `.npy`, or another array.
    """
    path = regular_file(path, NPY, unreadable)
    try:
        samples = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise unreadable(path, _reason(error), NPY) from error
    if not isinstance(samples, np.ndarray) or samples.ndim != 2 or samples.dtype.kind not in "iuf":
        found = getattr(samples, "dtype", "an archive"), getattr(samples, "shape", "of arrays")
        raise unreadable(path, "{} {}".format(*found), NPY)
    return checked(path, Signal(lambda start, stop: samples[:, start:stop], *samples.shape), NPY)


def _reason(error: Exception) -> str:
    strerror = getattr(error, "strerror", None)
    return strerror.lower() if strerror else str(error)
