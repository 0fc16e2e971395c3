import numpy as np
import pytest
from oracles.signals import write_sio
from scipy.io import wavfile


@pytest.fixture
def write(tmp_path):
    """Write samples (channels, number) as a file of a kind."""

    def write(kind, samples, **changed):
        path = tmp_path / f"array.{kind}"
        if kind == "wav":
            wavfile.write(path, 1500, samples.T)
        elif kind == "npy":
            np.save(path, samples)
        else:
            write_sio(path, samples, **changed)
        return path

    return write


@pytest.fixture
def samples():
    """Three channels of 1000 whole numbers."""
    return np.random.default_rng(0).integers(-(2**15), 2**15, (3, 1000)).astype("i2")
