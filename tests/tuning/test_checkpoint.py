import random

import pytest
import torch

from torchdt.checkpoint import save_checkpoint
from torchdt.errors import InputError
from torchdt.tuning.checkpoint import KIND, load_state, save_state
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.gradient import ascend

FINGERPRINT = {"seed": 0, "tuning.learning_rate": 0.1, "train_seeds": [0, 1]}
CONFIG = TuningConfig(steps=12, heldout_every=3)


class Killed(Exception):
    pass


def climb(path, make, quadratic, stop=None):
    """Run to the end, or until an exception interrupts step `stop`; then go on from the last checkpoint."""
    state = load_state(path, FINGERPRINT)
    done = len(state.records) if state else 0
    train = quadratic(fail_at={4: "nan"}, calls=done)

    def interrupted(values):
        if train.calls == stop:
            raise Killed
        return train(values)

    interrupted.num_steps = train.num_steps
    for reached in ascend(make(), interrupted, quadratic(), CONFIG, state):
        save_state(path, FINGERPRINT, reached)
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
    again = load_state(path, FINGERPRINT)
    assert again.records == state.records
    assert again.optimizer["state"].keys() == state.optimizer["state"].keys()
    for key, moments in state.optimizer["state"].items():
        assert all(torch.equal(moments[name], again.optimizer["state"][key][name]) for name in moments)
    assert again.finished


def test_no_file(tmp_path):
    assert load_state(tmp_path / "none.pt", FINGERPRINT) is None


@pytest.mark.parametrize("content", [{"x": 1}, {"records": [{"step": 0}]}, {"records": [], "x": 1}])
def test_another_content(tmp_path, content):
    path = tmp_path / "other.pt"
    save_checkpoint(path, KIND, FINGERPRINT, content)
    with pytest.raises(InputError, match=r"other.pt'.*expected a complete checkpoint of 'tune'"):
        load_state(path, FINGERPRINT)
