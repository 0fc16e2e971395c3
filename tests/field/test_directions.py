import math

import pytest
import torch

from torchdt.field.directions import (
    DIRECTIONS,
    from_azimuth_elevation,
    from_bearing,
    from_direction_cosines,
    in_unit_circle,
)

F64 = torch.float64
ANY = {
    "direction_cosines": torch.tensor([[0.3, -0.5], [0.0, 0.0], [-0.9, 0.2], [0.8, 0.9]], dtype=F64),
    "azimuth_elevation": torch.tensor([[20.0, 5.0], [-170.0, 60.0], [350.0, 0.0]], dtype=F64),
    "bearing": torch.tensor([[0.0], [123.0], [-40.0]], dtype=F64),
}


def test_axes_are_east_north_up():
    """Where one looks towards each of them."""
    found = from_azimuth_elevation(torch.tensor([[90.0, 0.0], [0.0, 0.0], [35.0, 90.0]], dtype=F64))
    torch.testing.assert_close(found, torch.eye(3, dtype=F64))
    found = from_direction_cosines(torch.tensor([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], dtype=F64))
    torch.testing.assert_close(found, torch.eye(3, dtype=F64))


def test_coordinates_agree():
    """The same directions in each of them."""
    az, el = torch.tensor([[10.0, 20.0], [250.0, 70.0], [-30.0, 1.0]], dtype=F64).unbind(-1)
    vector = from_azimuth_elevation(torch.stack([az, el], -1))
    east = [math.cos(math.radians(e)) * math.sin(math.radians(a)) for a, e in zip(az, el, strict=True)]
    assert vector[:, 0].tolist() == pytest.approx(east)
    torch.testing.assert_close(from_direction_cosines(vector[:, :2]), vector)
    level = from_azimuth_elevation(torch.stack([az, 0 * el], -1))
    torch.testing.assert_close(from_bearing(az[:, None]), level)


@pytest.mark.parametrize("name", DIRECTIONS)
def test_unit_length_and_shapes(name):
    kind, position = DIRECTIONS[name], ANY[name].expand(2, -1, -1)
    assert position.shape[-1] == kind.num_coordinates
    vector = kind.vector(position)
    assert vector.shape == (*position.shape[:-1], 3)
    torch.testing.assert_close(
        torch.linalg.vector_norm(vector, dim=-1), torch.ones(position.shape[:-1], dtype=F64)
    )
    if name == "direction_cosines":
        inside = kind.inside(position)
        assert inside.dtype == torch.bool
        assert inside[0].tolist() == [n < 3 for n in range(len(ANY[name]))]
    else:
        assert kind.inside is None


@pytest.mark.parametrize("name", DIRECTIONS)
def test_gradcheck(name):
    assert torch.autograd.gradcheck(DIRECTIONS[name].vector, (ANY[name].clone().requires_grad_(),))


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_on_the_horizon_and_beyond(dtype):
    """The nearest direction on the horizon, and finite gradients, also at the edge itself."""
    angle = torch.linspace(0, 6, 50, dtype=dtype)
    edge = torch.stack([angle.cos(), angle.sin()], -1)
    for radius in (1 - torch.finfo(dtype).eps, 1.0, 1 + torch.finfo(dtype).eps, 1.7):
        position = (radius * edge).requires_grad_()
        vector = from_direction_cosines(position)
        near = torch.cat([edge, torch.zeros_like(edge[:, :1])], -1)
        torch.testing.assert_close(vector, near, rtol=0, atol=2 * torch.finfo(dtype).eps ** 0.5)
        (gradient,) = torch.autograd.grad(vector.sum(), position)
        assert gradient.isfinite().all()
    assert not in_unit_circle(1.001 * edge).any()
    assert in_unit_circle(0.999 * edge).all()
