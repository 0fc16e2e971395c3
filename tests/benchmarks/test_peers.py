import math
from unittest import mock

import numpy as np
import pytest
import torch

from benchmarks import peers
from torchdt.core.random import RandomStreams

pytestmark = pytest.mark.slow


def kalman(first, measured):
    """Mean position (2,) and log p(z_k | ...) (K,) of one coordinate after another, exactly."""
    F = np.array([[1.0, peers.STEP_S], [0.0, 1.0]])
    W = np.array([peers.STEP_S**2 / 2, peers.STEP_S])
    mean = np.stack([first, np.zeros(2)])
    covariance = np.diag([peers.SPREAD**2, peers.RATE**2])
    evidence = []
    for z in measured:
        mean, covariance = F @ mean, F @ covariance @ F.T + peers.DRIVING * np.outer(W, W)
        variance = covariance[0, 0] + peers.SPREAD**2
        misfit = (z - mean[0]) ** 2 / variance
        evidence.append(-0.5 * (misfit + math.log(2 * math.pi * variance)).sum())
        gain = covariance[:, 0] / variance
        mean, covariance = mean + np.outer(gain, z - mean[0]), covariance - np.outer(gain, covariance[0])
    return mean[0], np.array(evidence)


def test_the_filter_is_that_of_kalman():
    streams = RandomStreams.from_seeds([0], (), torch.float64)
    first, *measured = peers.measure_walk(streams)[:11]
    particles, _ = peers.own_filter(first, 50_000, streams)
    numbers = (torch.full((2,), v, dtype=torch.float64) for v in (peers.DRIVING, peers.SPREAD))
    driving, spread = numbers
    evidence = []
    for z in measured:
        particles, log_weight, log_evidence = peers.filter_step(particles, z, driving, spread, streams)
        evidence.append(float(log_evidence))
    mean, expected = kalman(first.numpy(), [z.numpy() for z in measured])
    np.testing.assert_allclose(evidence, expected, atol=0.05)
    np.testing.assert_allclose(particles[:, :2].mean(0).numpy(), mean, atol=0.3)
    torch.testing.assert_close(log_weight.exp(), torch.full_like(log_weight, 1 / 50_000))


def test_the_gradient_is_that_of_the_evidence():
    streams = RandomStreams.from_seeds([0], (), torch.float64)
    first, position = peers.measure_walk(streams)[:2]
    particles, _ = peers.own_filter(first, 500, streams)
    driving = torch.full((2,), peers.DRIVING, dtype=torch.float64)
    began = streams.snapshot()

    def log_evidence(spread):
        return peers.filter_step(particles, position, driving, spread, streams.at(began))[2]

    spread = torch.full((2,), peers.SPREAD, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(log_evidence, spread)


def test_every_count_has_its_rows():
    rows = peers.measure_peers([20, 40], 1, "cpu")
    own = {row.quantity: row.value for row in rows if row.quantity.startswith("torchdt")}
    assert list(own) == [
        f"torchdt, {way}{count} particles" for count in (20, 40) for way in ("", "forward and back, ")
    ]
    assert all(0 < value < math.inf for value in own.values())


def test_what_is_not_installed_is_left_out():
    with mock.patch.object(peers.importlib.util, "find_spec", return_value=None):
        rows = {row.quantity: row for row in peers.measure_peers([20], 1, "cpu")}
    for name in ("Stone Soup, 20 particles", "pydpf, forward and back, 20 particles"):
        assert math.isnan(rows[name].value)
        assert rows[name].note == "left out: not installed"
    assert len(rows) == 4


def test_stone_soup_does_the_same_work():
    pytest.importorskip("stonesoup")
    rows = {row.quantity: row for row in peers.beside_stone_soup(2000, 3, "cpu")}
    assert rows["between the estimates, 2000 particles"].value < 2.0
    other, own = (rows[f"{name}, 2000 particles"].value for name in ("Stone Soup", "torchdt"))
    assert rows["Stone Soup / torchdt, 2000 particles"].value == pytest.approx(other / own)
