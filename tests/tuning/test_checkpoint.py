import random

import pytest
import torch

from torchdt.errors import InputError
from torchdt.tuning.checkpoint import flatten, load_checkpoint, save_checkpoint
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.gradient import ascend
from torchdt.tuning.state import initial_state

FINGERPRINT = {"seed": 0, "tuning.learning_rate": 0.1, "train_seeds": [0, 1]}
CONFIG = TuningConfig(steps=12, heldout_every=3)


class Killed(Exception):
    pass


def climb(path, make, quadratic, stop=None):
    """Run to the end, or until an exception interrupts step `stop`; then go on from the last checkpoint."""
    state = load_checkpoint(path, FINGERPRINT)
    done = len(state.records) if state else 0
    train = quadratic(fail_at={4: "nan"}, calls=done)

    def interrupted(values):
        if train.calls == stop:
            raise Killed
        return train(values)

    interrupted.num_steps = train.num_steps
    for reached in ascend(make(), interrupted, quadratic(), CONFIG, state):
        save_checkpoint(path, reached, FINGERPRINT)
    return reached


@pytest.fixture
def saved(tmp_path, make, quadratic):
    path = tmp_path / "checkpoint.pt"
    return path, climb(path, make, quadratic)


@pytest.mark.parametrize("stop", random.Random(5).sample(range(12), 4))
def test_interrupted_run_goes_on_as_if_never_stopped(tmp_path, make, quadratic, saved, stop):
    _, whole = saved
    path = tmp_path / "interrupted.pt"
    with pytest.raises(Killed):
        climb(path, make, quadratic, stop)
    resumed = climb(path, make, quadratic)
    assert resumed.records == whole.records
    assert all(torch.equal(resumed.best[name], whole.best[name]) for name in whole.best)


def test_round_trip(saved):
    path, state = saved
    again = load_checkpoint(path, FINGERPRINT)
    assert again.records == state.records
    assert again.optimizer["state"].keys() == state.optimizer["state"].keys()
    for key, moments in state.optimizer["state"].items():
        assert all(torch.equal(moments[name], again.optimizer["state"][key][name]) for name in moments)
    assert again.finished


def test_no_file(tmp_path):
    assert load_checkpoint(tmp_path / "none.pt", FINGERPRINT) is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tuning.learning_rate": 0.2}, "key 'tuning.learning_rate': found 0.2, expected 0.1, as in "),
        ({"seed": 1, "train_seeds": [2]}, "key 'seed': found 1, expected 0"),
        ({"new": 3}, "key 'new': found 3, expected nothing"),
    ],
)
def test_other_configuration(saved, changes, words):
    path, _ = saved
    before = path.read_bytes()
    with pytest.raises(InputError) as error:
        load_checkpoint(path, FINGERPRINT | changes)
    assert words in str(error.value)
    assert path.read_bytes() == before


def test_configuration_with_a_key_less(saved):
    path, _ = saved
    with pytest.raises(InputError, match=r"key 'train_seeds': found nothing, expected \[0, 1\]"):
        load_checkpoint(path, {"seed": 0, "tuning.learning_rate": 0.1})


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_part_of_a_file(saved, share):
    path, _ = saved
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"checkpoint.pt'.*expected a complete checkpoint"):
        load_checkpoint(path, FINGERPRINT)


@pytest.mark.parametrize(
    "content",
    [b"text", {"weights": torch.zeros(2)}, torch.zeros(2), [1], {"fingerprint": {}, "state": {"x": 1}}],
)
def test_other_files(tmp_path, content):
    path = tmp_path / "other.pt"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        torch.save(content, path)
    with pytest.raises(InputError, match=r"other.pt'.*expected a complete checkpoint"):
        load_checkpoint(path, FINGERPRINT)


def test_failed_write_leaves_the_old_file(saved, make):
    path, _ = saved
    before = path.read_bytes()
    with pytest.raises(Exception, match="pickle"):
        save_checkpoint(path, initial_state(make()), {"function": lambda: None})
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_flatten():
    nested = {"a": {"b": 1, "c": {"d": [2]}}, "e": None, "f": {}}
    assert flatten(nested) == {"a.b": 1, "a.c.d": [2], "e": None, "f": {}}
