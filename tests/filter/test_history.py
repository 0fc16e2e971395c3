"""Estimates of single steps, and of a whole recording."""

import pytest
import torch

from torchdt.filter.history import StepEstimate, TrackHistory, history_like

STEPS, SLOTS = 3, 2


@pytest.fixture
def history() -> TrackHistory:
    """Four sequences, all values different."""
    like = history_like(4, STEPS, SLOTS, 1, 2, 5, torch.float64)
    return TrackHistory(*(torch.arange(t.numel()).reshape(t.shape) for t in like))


def test_steps_of_a_history_make_it_up_again(history):
    steps = history.steps(1)
    assert [type(step) for step in steps] == [StepEstimate] * STEPS
    assert steps[2].power.shape == (4, SLOTS, 5)
    assert torch.equal(steps[2].noise, history.noise[:, 2])
    found = TrackHistory.of_steps(steps, 1)
    assert type(found) is TrackHistory
    for name, values in history._asdict().items():
        assert torch.equal(getattr(found, name), values), name


def test_a_sequence_keeps_the_kind_of_estimates(history):
    one = history.select(2)
    assert type(one) is TrackHistory
    assert torch.equal(one.state, history.state[2])
    assert type(history.steps(1)[0].select(2)) is StepEstimate
    assert torch.equal(one.steps(0)[1].label, history.steps(1)[1].select(2).label)
