import random

import pytest
import torch
from oracles.storage import full_disk

from torchdt.core.errors import InputError, StorageError
from torchdt.run.checkpoint import flatten, load_checkpoint, save_checkpoint

FINGERPRINT = {"seed": 0, "tuning.learning_rate": 0.1, "train_seeds": [0, 1]}


class Thing:
    """What PyTorch refuses to make from a file unless it is told to trust that."""


@pytest.fixture
def content():
    return {
        "state": (torch.rand(2, 3), (torch.arange(4),)),
        "moments": {0: {"step": torch.tensor(3.0)}},
        "name": "first",
        "nothing": None,
    }


@pytest.fixture
def saved(tmp_path, content):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, "track", FINGERPRINT, content)
    return path


def test_round_trip(saved, content):
    again = load_checkpoint(saved, "track", FINGERPRINT)
    assert again.keys() == content.keys()
    assert torch.equal(again["state"][0], content["state"][0])
    assert torch.equal(again["state"][1][0], content["state"][1][0])
    assert again["moments"][0]["step"] == 3
    assert (again["name"], again["nothing"]) == ("first", None)


def test_no_file(tmp_path):
    assert load_checkpoint(tmp_path / "none.pt", "track", FINGERPRINT) is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tuning.learning_rate": 0.2}, "key 'tuning.learning_rate': found 0.2, expected 0.1, as in "),
        ({"seed": 1, "train_seeds": [2]}, "key 'seed': found 1, expected 0"),
        ({"new": 3}, "key 'new': found 3, expected nothing"),
    ],
)
def test_other_configuration(saved, changes, words):
    before = saved.read_bytes()
    with pytest.raises(InputError) as error:
        load_checkpoint(saved, "track", FINGERPRINT | changes)
    assert words in str(error.value)
    assert str(error.value).endswith(f"as in {saved}; another folder starts anew")
    assert saved.read_bytes() == before


def test_configuration_with_a_key_less(saved):
    with pytest.raises(InputError, match=r"key 'train_seeds': found nothing, expected \[0, 1\]"):
        load_checkpoint(saved, "track", {"seed": 0, "tuning.learning_rate": 0.1})


def test_other_kind_of_job(saved):
    with pytest.raises(
        InputError, match=r"checkpoint.pt': found a checkpoint of 'track', expected one of 'tune'"
    ):
        load_checkpoint(saved, "tune", {})


@pytest.mark.parametrize("share", [0.0, random.Random(5).random(), 0.99])
def test_part_of_a_file(saved, share):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"checkpoint.pt'.*expected a complete checkpoint of 'track'"):
        load_checkpoint(saved, "track", FINGERPRINT)


@pytest.mark.parametrize(
    "content",
    [
        b"text",
        {"weights": torch.zeros(2)},
        torch.zeros(2),
        [1],
        {"kind": "track", "fingerprint": FINGERPRINT, "content": 1},
        {"kind": "track", "fingerprint": FINGERPRINT, "content": {"thing": Thing()}},
    ],
)
def test_other_files(tmp_path, content):
    path = tmp_path / "other.pt"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        torch.save(content, path)
    with pytest.raises(InputError, match=r"other.pt'.*expected a complete checkpoint of 'track'"):
        load_checkpoint(path, "track", FINGERPRINT)


def test_what_cannot_be_stored_leaves_the_old_file(saved):
    before = saved.read_bytes()
    with pytest.raises(Exception, match="pickle"):
        save_checkpoint(saved, "track", FINGERPRINT, {"function": lambda: None})
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_a_full_disk_leaves_the_old_file(saved):
    before = saved.read_bytes()
    with full_disk(), pytest.raises(StorageError, match=f"^cannot write {saved}: No space left on device$"):
        save_checkpoint(saved, "track", FINGERPRINT, {"more": torch.rand(5)})
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_flatten():
    nested = {"a": {"b": 1, "c": {"d": [2]}}, "e": None, "f": {}}
    assert flatten(nested) == {"a.b": 1, "a.c.d": [2], "e": None, "f": {}}
