import errno
import os
import resource
from contextlib import contextmanager

import pytest
from oracles.storage import full_disk

from torchdt.core.atomic import atomic_write, storing
from torchdt.core.errors import StorageError


def write(path, content=b"new"):
    with atomic_write(path) as file:
        file.write(content)


@contextmanager
def short_files(size):
    """No file may become longer than this."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"old")
    return path


def is_untouched(path):
    return path.read_bytes() == b"old" and [p.name for p in path.parent.iterdir()] == ["file"]


def test_a_new_file_and_another_in_its_place(tmp_path):
    path = tmp_path / "file"
    for content in (b"first", b"second"):
        write(path, content)
        assert path.read_bytes() == content
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_it_takes_its_place_at_the_end(path):
    with atomic_write(path) as file:
        file.write(b"new")
        file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"


def test_another_error_is_passed_on(path):
    with pytest.raises(ZeroDivisionError), atomic_write(path) as file:
        file.write(b"%d" % (1 / 0))
    assert is_untouched(path)


def test_no_space_left(path):
    with full_disk(), pytest.raises(StorageError, match=f"^cannot write {path}: No space left on device$"):
        write(path)
    assert is_untouched(path)


def test_a_file_that_may_not_become_so_long(path):
    with short_files(1000), pytest.raises(StorageError, match=f"^cannot write {path}: File too large$"):
        write(path, bytes(2000))
    assert is_untouched(path)


def test_no_permission_to_replace(path, monkeypatch):
    def refuse(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(StorageError, match=f"^cannot write {path}: Permission denied$"):
        write(path)
    assert is_untouched(path)


@pytest.mark.parametrize(
    ("folder", "reason"), [("nowhere", "No such file or directory"), ("file", "Not a directory")]
)
def test_no_folder(path, folder, reason):
    there = path.parent / folder / "new"
    with pytest.raises(StorageError, match=f"^cannot write {there}: {reason}$"):
        write(there)
    assert is_untouched(path)


def test_the_innermost_file_is_named():
    with pytest.raises(StorageError, match=r"^cannot write inner: full$"), storing("outer"), storing("inner"):
        raise OSError("full")


def test_an_error_without_a_number():
    with pytest.raises(StorageError, match=r"^cannot write events: Writer is closed$"), storing("events"):
        raise OSError("Writer is closed")
