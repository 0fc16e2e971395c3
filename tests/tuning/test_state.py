import pytest
import torch

from torchdt.tuning.state import TuningState, initial_state, note_heldout, numbers, raw_values, set_raw


def test_numbers():
    assert numbers({"a": 1.0, "b": [2.0, 3.0]}) == {"a": 1.0, "b_1": 2.0, "b_2": 3.0}


def test_raw_values_are_copies(make):
    hyperparameters = make("survival", "birth_mean")
    raw = raw_values(hyperparameters)
    set_raw(hyperparameters, {name: value + 1 for name, value in raw.items()})
    moved = raw_values(hyperparameters)
    for name in ("survival", "birth_mean"):
        assert torch.equal(moved[name], raw[name] + 1)
    set_raw(hyperparameters, raw)
    assert hyperparameters.values()["survival"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("heldout", "expected"), [(2.0, (2.0, 0)), (0.5, (1.0, 4)), (1.0, (1.0, 4)), (None, (1.0, 4))]
)
def test_note_heldout(heldout, expected):
    old, new = {"x": torch.tensor(0.0)}, {"x": torch.tensor(1.0)}
    best, *rest = note_heldout(TuningState(old, old, best_heldout=1.0, stale=3), new, heldout)
    assert tuple(rest) == expected
    assert best is (new if heldout == 2.0 else old)


def test_first_heldout_value_is_best(make):
    state = initial_state(make())
    assert (state.passes, state.skipped, state.best_heldout) == (0, 0, None)
    assert note_heldout(state, state.raw, -1e9)[1:] == (-1e9, 0)
