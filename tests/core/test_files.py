"""Whatever is no file is refused by every reader, before it is opened."""

import os
from pathlib import Path

import pytest
import torch

from recordings.tart_file import read_tart
from torchdt.app.resume import fingerprint_of
from torchdt.app.settings import TrackSettings
from torchdt.core.errors import InputError
from torchdt.core.files import regular_file
from torchdt.data.npz import read_npz
from torchdt.data.signals.readers import open_npy, open_wav
from torchdt.data.signals.sio import open_sio
from torchdt.data.signals.truth import read_truth
from torchdt.field import read_env

NOT_UTF8 = os.fsdecode(b"array\xff")


def read_table(path):
    return read_truth(path, ["bearing"], torch.zeros(1, dtype=torch.float64))


@pytest.fixture
def paths(tmp_path):
    """A pipe that nobody will ever write to, a folder, and names that no file or no text can have."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / NOT_UTF8).touch()
    return {
        tmp_path / "pipe": "a pipe",
        tmp_path: "a folder",
        tmp_path / "nul\0": "a name with NUL",
        tmp_path / NOT_UTF8: "a name with NUL or with bytes that are no UTF-8",
        tmp_path / "nowhere": "no such file",
    }


@pytest.mark.parametrize("read", [read_npz, read_tart, read_env, open_wav, open_npy, open_sio, read_table])
def test_what_is_no_file_is_refused(paths, read):
    for path, found in paths.items():
        with pytest.raises(InputError, match=f"found .*{found}") as caught:
            read(path)
        str(caught.value).encode()


def test_a_file_is_taken(tmp_path):
    path = tmp_path / "größe.npz"
    path.touch()
    assert regular_file(str(path), "a file") == Path(path)


def test_the_fingerprint_of_a_run_waits_for_no_pipe(paths):
    """It is taken before the reader gets to refuse the path."""
    number = len(paths)
    fingerprint = fingerprint_of(TrackSettings(), map(str, paths))
    assert list(fingerprint.values())[-number:] == ["no file"] * number
