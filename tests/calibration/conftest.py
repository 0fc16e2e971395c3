"""A small problem for calibration: the waveguide of the configuration at three tones, two moving sources."""

from types import SimpleNamespace

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.waveguide import configured
from torch import Tensor

from torchdt.field.build import EnvironmentDraw, waveguide
from torchdt.field.waveguide.family import WaveguideFamily
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.model.measurement import Measurement, from_snapshots

TONES = (49.0, 148.0, 283.0)


@pytest.fixture(scope="session")
def family() -> WaveguideFamily:
    """Environments of two EOFs, tilt and water depth."""
    keywords = configured(freqs=TONES)

    def solve(draw: EnvironmentDraw) -> NormalModeField:
        return waveguide(**keywords, draw=draw, dtype=torch.float64)

    return WaveguideFamily(solve, [1.0, 1.0], 1.0, 1.0)


@pytest.fixture(scope="session")
def whole() -> WaveguideFamily:
    """Environments of everything that can be fitted."""
    keywords = configured(freqs=TONES)

    def solve(draw: EnvironmentDraw) -> NormalModeField:
        return waveguide(**keywords, draw=draw, dtype=torch.float64)

    sensors = {"gain_std_db": [1.0] * 21, "phase_std_deg": [10.0] * 21}
    return WaveguideFamily(solve, [1.0, 1.0], 1.0, 1.0, bow_std_m=2.0, slope_std_m_per_km=3.0, **sensors)


@pytest.fixture(scope="session")
def nominal(family) -> NormalModeField:
    return family.solve(torch.zeros(4, dtype=torch.float64))


@pytest.fixture(scope="session")
def scene(family) -> SimpleNamespace:
    """Eight steps of two sources in an environment that is not the nominal one, 20 dB over the noise."""
    theta = torch.tensor([0.6, -0.8, 0.7, -0.8], dtype=torch.float64)
    field = family.solve(theta)
    truth = make_tracks(8)
    return SimpleNamespace(theta=theta, field=field, truth=truth, measurement=simulate(field(truth), seed=3))


def make_tracks(steps: int) -> Tensor:
    """Ranges and depths `(S, 2, 2)` of two sources."""
    along = torch.linspace(0, 1, steps, dtype=torch.float64)
    first = torch.stack([3400 - 700 * along, 58 + 0 * along], -1)
    second = torch.stack([2300 + 500 * along, 35 + 0 * along], -1)
    return torch.stack([first, second], 1)


def simulate(response: Tensor, seed: int, snr_db: float = 20.0, num_snapshots: int = 3) -> Measurement:
    """Snapshots of unit-power sources of responses `(S, N, I, M)`; the SNR is per sensor."""
    rng = torch.Generator().manual_seed(seed)
    num_steps, num_sources, num_tones, num_sensors = response.shape
    shape = (num_steps, num_tones, num_snapshots)
    z = complex_normal(rng, *shape, num_sensors) * (10 ** (-snr_db / 10) / num_sensors) ** 0.5
    amplitude = complex_normal(rng, *shape, num_sources)
    return from_snapshots(z + torch.einsum("sijn,snim->sijm", amplitude, response))


def scatter(field: NormalModeField, position: Tensor, share: float, seed: int) -> Tensor:
    """Responses of which a share of the energy is random, with the modes' incoherent covariance."""
    value, vector = torch.linalg.eigh(field.incoherent(position))
    draw = complex_normal(torch.Generator().manual_seed(seed + 1000), *value.shape)
    random = (vector @ (value.clamp_min(0).sqrt() * draw)[..., None])[..., 0]
    return (1 - share) ** 0.5 * field(position) + share**0.5 * random


@pytest.fixture(scope="session")
def tracks():
    return make_tracks


@pytest.fixture(scope="session")
def measure():
    return simulate


@pytest.fixture(scope="session")
def scattered():
    return scatter
