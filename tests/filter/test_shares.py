"""Shares of the energy of a step."""

import torch
from oracles.line_array import make_field

from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.messages import ObjectBelief
from torchdt.filter.interference.signatures import Interferers
from torchdt.filter.shares import PARTS, energy_shares
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.base import Noise
from torchdt.model.noise.white import WHITE

TONES, SENSORS, SNAPSHOTS = 2, 8, 400


def beliefs(strength: float, free: torch.Tensor, variance: float) -> Beliefs:
    """One object at 10 degrees of certain power, interferers and a noise level."""
    response = make_field()(torch.tensor([10.0, 0.0], dtype=torch.float64))
    moment = (response[..., None] * response[..., None, :].conj())[None]
    nothing = torch.zeros(1, 1, dtype=torch.float64)
    power = torch.full((1, TONES), strength, dtype=torch.float64)
    noise = Noise(torch.full((TONES, 1), variance, dtype=torch.float64), torch.zeros(TONES, 1).double())
    found = Interferers(free, torch.zeros(TONES, dtype=torch.float64), free)
    return Beliefs(ObjectBelief(nothing, nothing, nothing[0]), noise, moment, power, power, None, found)


def data(believed: Beliefs, seed: int = 0) -> torch.Tensor:
    """Snapshots `(I, J, M)` of what is believed."""
    covariance = WHITE.covariance(
        believed.signal + believed.interferers.covariance, believed.noise.mean, torch.ones(TONES, SENSORS)
    )
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn(TONES, SNAPSHOTS, SENSORS, dtype=torch.complex128, generator=generator)
    return white @ torch.linalg.cholesky(covariance).mT


def test_shares_are_those_of_the_powers():
    free = 2 * torch.randn(
        TONES, SENSORS, 1, dtype=torch.complex128, generator=torch.Generator().manual_seed(1)
    )
    believed = beliefs(20.0, free, 0.5)
    shares = energy_shares(believed, from_snapshots(data(believed)), WHITE)
    power = believed.strength[0, 0] * believed.moment[0].diagonal(dim1=-2, dim2=-1).real.sum(-1)
    parts = torch.stack([power, free.abs().square().sum((-2, -1)), torch.full((TONES,), 0.5 * SENSORS)], -1)
    expected = parts / parts.sum(-1, keepdim=True)
    torch.testing.assert_close(shares.sum(-1), torch.ones(TONES, dtype=torch.float64))
    torch.testing.assert_close(shares[:, :3], expected, rtol=0, atol=0.05)
    assert (shares[:, PARTS.index("unexplained")] < 0.05).all()


def test_energy_that_nothing_explains_is_unexplained():
    nothing = torch.zeros(TONES, SENSORS, 0, dtype=torch.complex128)
    believed = beliefs(20.0, nothing, 0.5)
    strange = 3 * torch.randn(TONES, SNAPSHOTS, SENSORS, dtype=torch.complex128)
    shares = energy_shares(believed, from_snapshots(data(believed) + strange), WHITE)
    assert (shares[:, PARTS.index("unexplained")] > 0.5).all()


def test_without_data_nothing_is_shared():
    believed = beliefs(20.0, torch.zeros(TONES, SENSORS, 0, dtype=torch.complex128), 0.5)
    missing = from_snapshots(torch.full((TONES, 3, SENSORS), torch.nan, dtype=torch.complex128))
    assert energy_shares(believed, missing, WHITE).eq(0).all()
