import math

import pytest
import torch

from torchdt.model.existence import condition_inside, drop_outside, predict_log_odds
from torchdt.model.motion.constant_velocity import predict_moments, predict_state
from torchdt.model.region import Coordinate, Region


def test_prediction_equals_the_matrices():
    rng = torch.Generator().manual_seed(1)
    state = torch.randn(4, 7, 4, generator=rng).double()
    driving = torch.randn(4, 7, 2, generator=rng).double()
    variance, T = torch.tensor([1e-2, 1e-5], dtype=torch.float64), 4.096
    F = torch.tensor([[1, 0, T, 0], [0, 1, 0, T], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=torch.float64)
    W = torch.tensor([[T**2 / 2, 0], [0, T**2 / 2], [T, 0], [0, T]], dtype=torch.float64)
    expected = torch.einsum("ij,...j->...i", F, state) + torch.einsum(
        "ij,...j->...i", W, driving * variance.sqrt()
    )
    torch.testing.assert_close(predict_state(state, driving * variance.sqrt(), T), expected)


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
@pytest.mark.parametrize("shared", [True, False])
def test_moments_are_those_of_predicted_states(batch, shared):
    """Cubature: 12 points of state and driving noise with exactly their moments, each moved by itself."""
    rng, T = torch.Generator().manual_seed(2), 4.096
    mean = torch.randn(*batch, 4, generator=rng).double()
    root = torch.randn(*batch, 4, 4, generator=rng).double()
    variance = torch.rand(*(() if shared else batch), 2, generator=rng).double() + 0.1
    joint = torch.zeros(*batch, 6, 6, dtype=torch.float64)
    joint[..., :4, :4] = torch.linalg.cholesky(root @ root.mT)
    joint[..., 4:, 4:] = torch.diag_embed(variance.sqrt())
    offset = 6**0.5 * torch.cat([joint, -joint], -1).mT  # (*batch, 12, 6)
    moved = predict_state(mean[..., None, :] + offset[..., :4], offset[..., 4:], T)
    centred = moved - moved.mean(-2, keepdim=True)
    found = predict_moments(mean, root @ root.mT, T, variance)
    torch.testing.assert_close(found[0], moved.mean(-2))
    torch.testing.assert_close(found[1], centred.mT @ centred / 12)


def test_existence_equals_the_product_of_probabilities():
    existence = torch.tensor([1e-6, 0.3, 0.99], dtype=torch.float64)
    found = torch.sigmoid(predict_log_odds(torch.logit(existence), 0.95))
    torch.testing.assert_close(found, 0.95 * existence)


def test_existence_at_the_limits_stays_finite():
    log_odds = torch.tensor([-math.inf, -200.0, 200.0])
    found = predict_log_odds(log_odds, 0.95)
    assert found[0] == -math.inf
    assert found[1].item() == pytest.approx(-200 + math.log(0.95), rel=1e-6)
    assert found[2].item() == pytest.approx(math.log(0.95 / 0.05), rel=1e-5)


def test_particles_outside_lose_their_weight():
    """What is lost is the probability that the object left, so nothing is renormalised."""
    region = Region([Coordinate("bearing", "deg", -10, 10, 2, -1, 1, 1e-3)], torch.float64)
    state = torch.tensor([[[0.0, 5.0], [-10.5, 0.0], [9.9, 0.0]], [[11.0, 0.0], [12.0, 0.0], [-20.0, 0.0]]])
    weight = torch.tensor([[0.2, 0.5, 0.3], [0.2, 0.5, 0.3]], dtype=torch.float64)
    kept = drop_outside(state.double(), weight.log(), region).exp()
    torch.testing.assert_close(kept, torch.tensor([[0.2, 0.0, 0.3], [0.0, 0.0, 0.0]], dtype=torch.float64))


def test_weights_given_that_the_object_is_inside():
    """Sets partly, wholly and not at all outside, and empty ones; float32 rounding is no death."""
    region = Region([Coordinate("bearing", "deg", -10, 10, 2, -1, 1, 1e-3)])
    state = torch.tensor([[0.0, -10.5, 9.9], [1.0, 2.0, 3.0], [11.0, 12.0, -20.0]])[..., None]
    weight = torch.tensor([[0.2, 0.5, 0.3], [0.2, 0.5, 0.30001], [0.2, 0.5, 0.3]])
    found, log_inside = condition_inside(state, weight.log(), region)
    torch.testing.assert_close(found[0].exp(), torch.tensor([0.4, 0.0, 0.6]))
    torch.testing.assert_close(log_inside[0].exp().item(), 0.5)
    assert log_inside[1] == 0
    assert torch.equal(found[1], weight[1].log())
    assert log_inside[2].exp() < 1e-37
    assert found[2].eq(-math.inf).all()


def test_gradient_of_leaving():
    """`P(inside)` and the weights in the former weights, against finite differences."""
    region = Region([Coordinate("bearing", "deg", -10, 10, 2, -1, 1, 1e-3)], torch.float64)
    state = torch.tensor([[0.0, -10.5, 9.9], [1.0, 2.0, 3.0]], dtype=torch.float64)[..., None]
    weight = torch.tensor([[0.2, 0.5, 0.3], [0.2, 0.5, 0.3]], dtype=torch.float64).log().requires_grad_()

    def kept(log_weight):
        found, log_inside = condition_inside(state, log_weight, region)
        return found.exp(), predict_log_odds(torch.zeros(2).double(), 0.9 * log_inside.exp())

    assert torch.autograd.gradcheck(kept, weight)
