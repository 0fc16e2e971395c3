import pytest
import torch

from torchdt.app.report.belief import belief_of
from torchdt.baselines.mot.tracker import PointObjects, PointState


@pytest.fixture
def estimate(history):
    return history.select(1).select(2)


def test_powers_of_direct_tracking_are_in_units_of_the_data(state, estimate):
    belief = belief_of(state, estimate)
    torch.testing.assert_close(belief.power[0, 0], torch.tensor([5.0, 10, 20]))
    torch.testing.assert_close(belief.power[1, 1], torch.tensor([500.0, 1000, 2000]))
    torch.testing.assert_close((belief.power * belief.power_weight).sum(-1), estimate.power)
    torch.testing.assert_close(belief.power_weight.sum(-1), torch.ones(3, 2))


def test_particles_are_those_of_the_state(state, estimate):
    belief = belief_of(state, estimate)
    assert torch.equal(belief.particles, state.objects.state)
    torch.testing.assert_close(belief.weight.sum(-1), torch.ones(3))
    torch.testing.assert_close(belief.weight, state.objects.log_weight.exp())


def test_points_have_one_value_for_a_power(state, estimate):
    known = state.objects
    points = PointObjects(known.state, known.log_weight, known.log_odds, known.label, known.mean_power)
    belief = belief_of(PointState(points, torch.tensor(13)), estimate)
    assert torch.equal(belief.power, estimate.power[..., None])
    assert torch.equal(belief.power_weight, torch.ones(3, 2, 1))
    assert torch.equal(belief.particles, known.state)
    torch.testing.assert_close(belief.weight.sum(-1), torch.ones(3))


def test_other_states_say_nothing(estimate):
    assert belief_of((1, 2), estimate) is None
