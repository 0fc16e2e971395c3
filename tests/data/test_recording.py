"""Parts and repetitions of recordings; `test_npz.py` covers what a recording must be."""

import pytest
import torch
from oracles.arrays import sample_covariance

from torchdt.data.recording import Recording, validate


@pytest.fixture(params=["snapshots", "covariance"])
def recording(request) -> Recording:
    rng = torch.Generator().manual_seed(1)
    snapshots = torch.randn(4, 5, 2, 3, 6, generator=rng, dtype=torch.complex128)
    truth = torch.randn(4, 5, 1, 2, generator=rng, dtype=torch.float64)
    array = {"freqs": torch.tensor([50.0, 60.0]), "truth": truth, "name": "four"}
    if request.param == "snapshots":
        return validate(step_s=2.0, snapshots=snapshots, **array)
    return validate(step_s=2.0, covariance=sample_covariance(snapshots), num_snapshots=3, **array)


def assert_sequences(found: Recording, whole: Recording, sequences: list[int]) -> None:
    assert torch.equal(found.data, whole.data[sequences])
    assert torch.equal(found.truth, whole.truth[sequences])
    assert (found.snapshots is None, found.covariance is None) == (
        whole.snapshots is None,
        whole.covariance is None,
    )
    for name in ("step_s", "num_snapshots", "freqs", "name"):
        assert getattr(found, name) is getattr(whole, name)


def test_some_sequences(recording):
    part = recording.select(slice(1, 3))
    assert_sequences(part, recording, [1, 2])
    assert part.data.data_ptr() == recording.data[1].data_ptr()  # not a copy


def test_repeated_sequences(recording):
    assert_sequences(recording.repeat(2), recording, [0, 1, 2, 3, 0, 1, 2, 3])


def test_without_truth():
    plain = validate(step_s=1.0, snapshots=torch.ones(2, 1, 1, 1, 2, dtype=torch.complex64))
    assert plain.select(slice(0, 1)).truth is None
    assert plain.repeat(3).truth is None
