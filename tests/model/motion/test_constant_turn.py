"""Arcs of circles: against the circle itself, the matrix of constant velocity, and sampled moments."""

import math

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.model.model import Model
from torchdt.model.motion.base import Motion
from torchdt.model.motion.constant_turn import ConstantTurn
from torchdt.model.motion.constant_velocity import predict_moments, predict_state
from torchdt.model.motion.driving import Reparameterised, Score
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
PLANE = Region([Coordinate(name, "m", -100, 100, 10, -5, 5, 0.04) for name in ("x", "y")], F64)
MOTION = ConstantTurn(turn_variance=1e-4, turn_spread=0.2).on(PLANE)
STILL = torch.zeros(3, dtype=F64)


@pytest.mark.parametrize("turn", [0.3, -0.05, 1e-6])
def test_states_follow_the_circle(turn):
    """Speed v on radius v / w around a fixed centre, by polar coordinates."""
    speed, heading, T = 4.0, 0.7, 2.5
    state = torch.tensor([1.0, -2.0, speed * math.cos(heading), speed * math.sin(heading), turn], dtype=F64)
    found = MOTION.move(state, STILL, T)
    later = heading + turn * T
    x = 1.0 + speed / turn * (math.sin(later) - math.sin(heading))
    y = -2.0 - speed / turn * (math.cos(later) - math.cos(heading))
    expected = [x, y, speed * math.cos(later), speed * math.sin(later), turn]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=F64), rtol=1e-9, atol=1e-9)


def test_a_turn_of_a_full_period_returns():
    rows = [[3.0, 4.0, 1.0, -2.0, math.pi / 6], [0.0, 1.0, 2.0, 0.5, -math.pi / 3]]
    moved = state = torch.tensor(rows, dtype=F64)
    for _ in range(12):
        moved = MOTION.move(moved, STILL, 1.0)
    torch.testing.assert_close(moved, state, rtol=0, atol=1e-12)


def test_without_a_turn_it_is_constant_velocity():
    rng = torch.Generator().manual_seed(1)
    state, driving = (torch.randn(3, 7, 4, generator=rng, dtype=F64) for _ in range(2))
    straight = torch.cat([state, torch.zeros(3, 7, 1)], -1)
    push = torch.cat([driving[..., :2], torch.zeros(3, 7, 1)], -1)
    found = MOTION.move(straight, push, 1.5)
    torch.testing.assert_close(found[..., :4], predict_state(state, driving[..., :2], 1.5))
    assert found[..., 4].eq(0).all()


def test_moments_without_a_turn_are_those_of_constant_velocity():
    """No turn, and next to none driven: the unscented transform is exact where the motion is linear."""
    rng = torch.Generator().manual_seed(2)
    root = torch.randn(4, 4, generator=rng, dtype=F64)
    mean = torch.randn(2, 5, generator=rng, dtype=F64)
    mean[..., 4] = 0
    covariance = torch.zeros(2, 5, 5, dtype=F64)
    covariance[..., :4, :4] = root @ root.mT
    motion = ConstantTurn(turn_variance=1e-20).on(PLANE)
    found = motion.moments(mean, covariance, 1.5)
    expected = predict_moments(mean[..., :4], root @ root.mT, 1.5, PLANE.driving_variance)
    torch.testing.assert_close(found[0][..., :4], expected[0], rtol=1e-7, atol=1e-7)
    torch.testing.assert_close(found[1][..., :4, :4], expected[1].expand(2, -1, -1), rtol=1e-6, atol=1e-6)


def test_moments_are_those_of_moved_samples():
    """400 000 samples: means within 5 deviations of their error (false alarm 1e-5 for ten of them)."""
    torch.manual_seed(3)
    T, number = 2.0, 400_000
    mean = torch.tensor([10.0, 5.0, 3.0, -1.0, 0.2], dtype=F64)
    covariance = torch.diag(torch.tensor([1.0, 2.0, 0.1, 0.2, 1e-3], dtype=F64))
    state = mean + torch.randn(1, number, 5, dtype=F64) @ covariance.sqrt()
    moved, log_ratio = MOTION.predict(state, torch.randn(1, number, 3, dtype=F64), T, Score())
    assert log_ratio.eq(0).all()
    found_mean, found = MOTION.moments(mean[None], covariance[None], T)
    sampled = moved[0].T.cov()
    error = (sampled.diagonal() / number).sqrt()
    assert ((found_mean[0] - moved[0].mean(0)).abs() < 5 * error + 1e-3).all()
    scale = sampled.diagonal().sqrt()
    assert ((found[0] - sampled).abs() / (scale[:, None] * scale)).max() < 0.02


def test_new_objects_have_rates_and_turn_rates():
    rng = torch.Generator().manual_seed(4)
    draws = torch.randn(2, 2000, 3, generator=rng, dtype=F64)
    position = torch.zeros(2, 2000, 2, dtype=F64)
    state = MOTION.newborn(PLANE, position, draws)
    assert state[..., 2:4].abs().max() < 5
    torch.testing.assert_close(state[..., 4], 0.2 * draws[..., 2])
    assert MOTION.complete(PLANE, position).eq(0).all()
    names = MOTION.column_names(PLANE.coordinates)
    assert names == ("x_m", "y_m", "x_rate_mps", "y_rate_mps", "turn_rate_radps")


def test_numbers_of_its_own_may_differ_between_sequences():
    model = Model(motion=ConstantTurn()).on(PLANE)
    model = model.with_numbers({"turn_variance": torch.tensor([1e-6, 4e-2])})
    assert isinstance(model.motion, Motion)
    state = torch.zeros(2, 1, 50, 5, dtype=F64)
    moved, _ = model.motion.predict(state, torch.ones(2, 1, 50, 3, dtype=F64), 1.0, Score())
    torch.testing.assert_close(moved[:, 0, 0, 4], torch.tensor([1e-3, 0.2], dtype=F64))


def test_gradient_reaches_the_turn_variance():
    state = torch.tensor([[[0.0, 0, 1, 0, 0.1]]], dtype=F64).expand(1, 4, 5)
    draws = torch.randn(1, 4, 3, dtype=F64, generator=torch.Generator().manual_seed(5))

    def moved(variance):
        motion = MOTION.with_numbers({"turn_variance": variance})
        return motion.predict(state, draws, 1.0, Reparameterised())[0]

    assert torch.autograd.gradcheck(moved, torch.tensor(1e-2, dtype=F64, requires_grad=True))


def test_it_wants_a_plane():
    line = Region([Coordinate("x", "m", -100, 100, 10, -5, 5, 0.04)])
    with pytest.raises(
        InputError, match=r"'model\.motion': found constant turn in 1 coordinates, expected two"
    ):
        ConstantTurn().on(line)
