"""What an interrupted or finished run of `track` does not take: other settings or data, part of a file."""

import random

import pytest
from oracles.interrupted import ALONE, KEPT, LINE, POINTS, contents, untouched
from oracles.storage import full_disk

from torchdt.data.npz import write_npz
from torchdt.run.checkpoint import save_checkpoint

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["tracker=mp_bp", "runs=2"], "key 'tracker': found mp_bp, expected direct, as in"),
        (["variants=[{survival: 0.9}]"], "key 'variants': found [{'survival': 0.9}], expected None, as in"),
    ],
)
def test_another_run_is_refused(start, whole, overrides, words):
    small = () if "tracker=mp_bp" not in overrides else (*LINE, *POINTS)
    before = untouched(whole.directory, *KEPT)
    other = start(whole.directory, "runs=2", *small, *overrides, small=not small)
    assert other.status == 1
    assert words in other.err
    assert f"as in {whole.directory / 'checkpoint.pt'}; another folder starts anew" in other.err
    assert untouched(whole.directory, *KEPT) == before


def test_another_run_does_not_go_on(start, half):
    before = {path: path.read_bytes() for path in (half.directory / "checkpoint").iterdir()}
    other = start(half.directory, "runs=2", "seed=1")
    assert "key 'seed': found 1, expected 0, as in" in other.err
    assert {path: path.read_bytes() for path in (half.directory / "checkpoint").iterdir()} == before


def test_other_data_under_the_same_name(start, tmp_path, recording):
    path, directory = tmp_path / "data.npz", tmp_path / "run"
    write_npz(path, recording)
    arguments = (directory, "data=npz", f"data.path={path}")
    assert start(*arguments).status == 0
    before = untouched(directory, *KEPT)
    recording.snapshots[0, 0, 0, 0, 0] *= 2
    write_npz(path, recording)
    recording.snapshots[0, 0, 0, 0, 0] /= 2
    other = start(*arguments)
    assert other.status == 1
    assert f"key 'content of {path}': found" in other.err
    path.unlink()
    gone = start(*arguments)
    assert f"key 'content of {path}': found no file, expected" in gone.err
    assert untouched(directory, *KEPT) == before


def test_the_checkpoint_of_another_job(start, tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, "tune", {}, {})
    outcome = start(tmp_path)
    assert outcome.status == 1
    assert f"path '{path}': found a checkpoint of 'tune', expected one of 'track'" in outcome.err
    assert not (tmp_path / "manifest.json").exists()


@pytest.mark.parametrize("name", ["checkpoint.pt", "checkpoint/1-1.pt"])
def test_part_of_a_checkpoint(start, half, name):
    path = half.directory / name
    content = path.read_bytes()
    path.write_bytes(content[: random.Random(3).randrange(len(content))])
    outcome = start(half.directory, "runs=2", ALONE)
    assert outcome.status == 1
    assert f"path '{path}': found a file of another kind, or part of one" in outcome.err


def test_a_full_disk(start, tmp_path, whole):
    arguments = (tmp_path, "runs=2", ALONE)
    folder = tmp_path / "checkpoint"
    with full_disk(lambda: (folder / "1-1.pt").exists()):
        outcome = start(*arguments)
    assert outcome.status == 1
    assert outcome.err == f"cannot write {folder / '1-1.pt'}: No space left on device\n"
    assert {path.name for path in folder.iterdir()} == {"plan.pt", "0-0.pt", "1-1.pt"}
    assert start(*arguments).status == 0
    assert contents(tmp_path) == contents(whole.directory)


def test_files_in_the_place_of_folders(start, tmp_path, whole):
    """One after the other is named and taken away; what was tracked until then is kept."""
    arguments = (tmp_path, "runs=2", ALONE, "logging=default")
    names = ("checkpoint", "tensorboard", "figures")
    for name in names:
        (tmp_path / name).write_bytes(b"")
    for name in names:
        outcome = start(*arguments)
        assert outcome.status == 1
        assert outcome.err.startswith(f"cannot write {tmp_path / name}: ")
        assert outcome.err.count("\n") == 1
        (tmp_path / name).unlink()
    assert start(*arguments).status == 0
    assert contents(tmp_path) == contents(whole.directory)
