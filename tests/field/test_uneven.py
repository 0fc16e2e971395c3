"""Sensors with gains and phases of their own, by plain sums."""

import math

import pytest
import torch
from oracles.waveguide import make_field

from torchdt.field.mismatch import MismatchedField
from torchdt.field.uneven import UnevenArrayField, sensor_gains

F64 = torch.float64
STATE = torch.tensor([[2345.0, 58.0], [3210.0, 20.0]], dtype=F64)


def test_gains_of_decibels_and_degrees():
    found = sensor_gains(torch.tensor([6.0, 0.0], dtype=F64), torch.tensor([0.0, 90.0], dtype=F64))
    torch.testing.assert_close(found, torch.tensor([10**0.3, 1j], dtype=torch.complex128))


@pytest.mark.parametrize("normalize", [False, True])
def test_responses_and_covariances(normalize):
    """Each sensor by its factor; normalised to the norm there was before."""
    even = make_field(dtype=F64)
    generator = torch.Generator().manual_seed(0)
    gain = torch.randn(even.num_sensors, generator=generator, dtype=torch.complex128)
    field = UnevenArrayField(even, gain, normalize=normalize)
    factor = (even(STATE) * gain).norm(dim=-1) / even(STATE).norm(dim=-1) if normalize else 1.0
    expected = even(STATE) * gain / torch.as_tensor(factor)[..., None]
    torch.testing.assert_close(field(STATE), expected)
    covariance = field.incoherent(STATE)
    if normalize:
        trace = covariance.diagonal(dim1=-2, dim2=-1).real.sum(-1)
        torch.testing.assert_close(trace, even(STATE).abs().square().sum(-1))
    scaled = even.incoherent(STATE)[0, 0] * torch.outer(gain, gain.conj())
    ratio = covariance[0, 0] / scaled
    torch.testing.assert_close(ratio, ratio[0, 0].expand_as(ratio))
    share = torch.full((even.num_tones,), 0.25, dtype=F64)
    diffuse = UnevenArrayField(MismatchedField(even, share), gain).diffuse(STATE)[0, 0]
    torch.testing.assert_close(diffuse, 0.25 * scaled)
    assert math.isclose(float(field.around(even).gain.abs()[0]), float(gain.abs()[0]))
