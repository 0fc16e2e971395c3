import math

import pytest
import torch

from torchdt.field import Field, LineArrayField

FREQS = (60.0, 200.0)
POSITIONS = (0.0, 2.5, 5.0, 11.0)


def test_equals_the_equation():
    field = LineArrayField(FREQS, POSITIONS, 1480.0, dtype=torch.float64)
    assert isinstance(field, Field)
    assert (field.num_tones, field.num_sensors, field.num_coordinates) == (2, 4, 1)
    response = field(torch.tensor([33.0, 0.1], dtype=torch.float64))
    for i, f in enumerate(FREQS):
        for m, x in enumerate(POSITIONS):
            angle = -2 * math.pi * f / 1480.0 * x * math.sin(math.radians(33.0))
            assert complex(response[i, m]) == pytest.approx(complex(math.cos(angle), math.sin(angle)) / 2)


def test_batch_equals_single_and_norm_is_one():
    field = LineArrayField(FREQS, POSITIONS)
    state = torch.rand(3, 5, 2) * 180 - 90
    response = field(state)
    assert response.shape == (3, 5, 2, 4)
    assert response.dtype == torch.complex64
    torch.testing.assert_close(response[1, 2], field(state[1, 2]))
    torch.testing.assert_close(torch.linalg.vector_norm(response, dim=-1), torch.ones(3, 5, 2))


def test_gradcheck():
    field = LineArrayField(FREQS, POSITIONS, dtype=torch.float64)
    state = torch.tensor([[-40.0, 0.2], [12.0, 0.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(field, (state,))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((), POSITIONS), "freqs is"),
        (((-1.0,), POSITIONS), "freqs is"),
        ((FREQS, ()), "positions is empty"),
        ((FREQS, POSITIONS, 0.0), "wave_speed is 0"),
    ],
)
def test_wrong_input_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        LineArrayField(*arguments)


@pytest.mark.parametrize("state", [torch.tensor(1.0), torch.zeros(2, dtype=torch.float64)])
def test_wrong_state_is_named(state):
    with pytest.raises(ValueError, match="state has shape"):
        LineArrayField(FREQS, POSITIONS)(state)
