"""Powers without memory: the message of the support points against the integral over the density."""

import math

import numpy as np
import pytest
import torch
from oracles.line_array import SMALL, make_field, make_region, simulate
from scipy.integrate import quad
from scipy.special import expn

from torchdt.core.random import RandomStreams
from torchdt.filter.bp.rank_one import log_likelihood_ratio
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.measurement import from_snapshots
from torchdt.model.model import Model
from torchdt.model.power.base import PowerModel
from torchdt.model.power.redrawn import RedrawnPower
from torchdt.model.prior import data_priors

F64 = torch.float64
POWER = RedrawnPower(torch.tensor(0.25, dtype=F64))


def message(J, mean, s, q, num_points):
    """`log int f(gamma) (1 + gamma s)^-J exp(gamma q / (1 + gamma s)) d gamma` by support points."""
    points, log_weight = POWER.initial(torch.tensor(4 * mean, dtype=F64), num_points)
    numbers = (torch.tensor(float(x), dtype=F64) for x in (J, s, q))
    J, s, q = numbers
    return torch.logsumexp(log_likelihood_ratio(J, points, s, q, log_weight), -1).item()


@pytest.mark.parametrize("J", [1, 3, 20])
@pytest.mark.parametrize("gain", [0.1, 3.0, 100.0])
def test_without_a_signal_the_message_is_an_exponential_integral(J, gain):
    """`z exp(z) E_J(z)` with `z = 1 / (g s)`."""
    mean = 2.0
    s = gain / mean
    expected = math.log(expn(J, 1 / gain) / gain) + 1 / gain
    coarse, fine = (abs(message(J, mean, s, 0.0, n) - expected) for n in (64, 256))
    assert fine < 1e-3
    assert fine < coarse / 4


@pytest.mark.parametrize("J", [1, 3, 20])
@pytest.mark.parametrize("peak", [0.2, 1.0, 4.0])
def test_with_a_signal_the_message_is_the_integral(J, peak):
    """The likelihood has its peak at a power of so many means, 20 dB above the background."""
    mean, s = 2.0, 50.0
    q = J * s * (1 + peak * mean * s)
    log_peak = J * (peak * mean * s - math.log1p(peak * mean * s))

    def integrand(power):
        value = -J * np.log1p(power * s) + power * q / (1 + power * s) - power / mean - log_peak
        return np.exp(value) / mean

    corners = peak * mean * np.array([0.01, 0.1, 0.5, 1.0, 2.0, 10.0])
    integral = quad(integrand, 0, 60 * mean, points=corners, limit=500)[0]
    assert message(J, mean, s, q, 256) == pytest.approx(math.log(integral) + log_peak, abs=2e-3)
    assert message(J, mean, s, q, 16) == pytest.approx(math.log(integral) + log_peak, abs=0.5)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
@pytest.mark.parametrize("num_points", [1, 2, 16])
def test_points_have_the_mean_and_the_mass_of_the_density(dtype, num_points):
    maximum = torch.tensor([[4.0, 8.0], [1.0, 2.0]], dtype=dtype)
    power = RedrawnPower(torch.tensor([0.25, 0.5], dtype=dtype))  # of two sequences
    assert isinstance(power, PowerModel)
    points, log_weight = power.initial(maximum, num_points)
    assert points.dtype == log_weight.dtype == dtype
    torch.testing.assert_close(log_weight.exp().sum(-1), torch.ones(2, 2, dtype=dtype))
    expected = torch.tensor([[1.0, 2.0], [0.5, 1.0]], dtype=dtype)
    torch.testing.assert_close((log_weight.exp() * points).sum(-1), expected)


def test_nothing_is_remembered():
    points, prior = POWER.initial(torch.ones(2, 3, dtype=F64), 16)
    sure = torch.full_like(prior, -50.0)
    sure[..., 3] = 0.0
    found, log_weight = POWER.predict(points, sure)
    torch.testing.assert_close(found, points)
    torch.testing.assert_close(log_weight, prior)


def test_a_fluctuating_object_is_followed():
    """Its power changes by 20 dB from step to step."""
    snapshots, truth = simulate(1, ((0.0, 5.0), (8.0, 8.0)), steps=8, snr_db=20.0)
    snapshots[1::2] = simulate(1, ((0.0, 5.0), (8.0, 8.0)), steps=8, snr_db=0.0)[0][1::2] / 10
    measurement = from_snapshots(snapshots[None])
    model, streams = Model(power=RedrawnPower()), RandomStreams.from_seeds([3], (1,), F64)
    tracker = DirectTracker(make_field(), make_region(), 1.0, TrackerConfig(**SMALL), model)
    with torch.inference_mode():
        history = tracker.run(measurement, data_priors(measurement), streams)
    assert history.declared[0, 2:].any(-1).all()
    found = history.position[0, -2, :, 0][history.declared[0, -2]]
    assert (found - truth[-2, 0, 0]).abs().min() < 1.5
