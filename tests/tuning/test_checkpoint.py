import dataclasses
import random

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.run.checkpoint import save_checkpoint
from torchdt.tuning.checkpoint import KIND, load_state, require_values, save_state
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.gradient import ascend
from torchdt.tuning.state import initial_state, raw_values

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


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"x": 1}, "content: the keys raw, .*, x, expected the keys raw"),
        ({"finished": "no"}, "content.finished: 'no', expected bool"),
        ({"raw": []}, "content.raw: 0 entries, expected dict"),
        ({"stale": None}, "content.stale: None, expected int"),
        ({"records": ()}, "no records, expected one for each step"),
        ({"records": ({"step": 0},)}, "content.records: the keys step, expected the keys step, values"),
    ],
)
def test_another_content(saved, changes, words):
    path, state = saved
    save_checkpoint(path, KIND, FINGERPRINT, dataclasses.asdict(state) | changes)
    with pytest.raises(InputError, match=rf"checkpoint.pt': found .*{words}.*; another folder starts anew"):
        load_state(path, FINGERPRINT)


def test_values_are_those_that_are_tuned(saved, make):
    path, state = saved
    start = raw_values(make())
    name = next(iter(start))
    require_values(path, state, start)
    require_values(path, initial_state(make()), start)
    optimizer = state.optimizer
    first = {**optimizer["state"], 0: {**optimizer["state"][0], "exp_avg": torch.zeros(9)}}
    less = [{"lr": 1}]
    bad = {
        "content.raw: the keys": {"raw": {"other": start[name]}},
        rf"content.best.{name}: a tensor \(9,\)": {"best": {**state.best, name: torch.zeros(9)}},
        rf"content.good.{name}: 1, expected a tensor": {"good": {**state.good, name: 1}},
        r"content.optimizer.state.0.exp_avg: a tensor \(9,\)": {"optimizer": {**optimizer, "state": first}},
        "content.optimizer.param_groups: 0 entries": {"optimizer": {**optimizer, "param_groups": []}},
        "content.optimizer.param_groups.0: the keys lr": {"optimizer": {**optimizer, "param_groups": less}},
    }
    for words, change in bad.items():
        with pytest.raises(InputError, match=rf"found {words}.*; another folder starts anew"):
            require_values(path, dataclasses.replace(state, **change), start)
