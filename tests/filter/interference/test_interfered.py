"""Noise with interferers is the noise with their covariance added to the signal."""

import pytest
import torch
from oracles.arrays import complex_normal, random_covariance
from oracles.interferers import any_level

from torchdt.filter.interference.interfered import Interfered
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.coloured import ColouredNoise
from torchdt.model.noise.white import WhiteNoise

F64 = torch.float64
BATCH, TONES, SENSORS = 3, 2, 5
RNG = torch.Generator().manual_seed(1)
COLUMNS = complex_normal(RNG, BATCH, TONES, SENSORS, 2)
COLUMNS[1] = 0  # a sequence without any
OBJECTS = complex_normal(RNG, BATCH, TONES, SENSORS, 3)
SIGNAL, ADDED = OBJECTS @ OBJECTS.mH, COLUMNS @ COLUMNS.mH
VARIANCE = torch.rand(BATCH, TONES, dtype=F64, generator=RNG) + 0.1
SNAPSHOTS = complex_normal(RNG, BATCH, TONES, 4, SENSORS)
SNAPSHOTS[0, 0, :, 2] = torch.nan
MEASUREMENT = from_snapshots(SNAPSHOTS)
EACH = pytest.mark.parametrize(
    "noise", [WhiteNoise(), ColouredNoise(matrix=random_covariance(RNG, TONES, sensors=SENSORS))]
)


@EACH
def test_covariance(noise):
    found = Interfered(noise, COLUMNS).covariance(SIGNAL, VARIANCE, MEASUREMENT.present)
    torch.testing.assert_close(found, noise.covariance(SIGNAL + ADDED, VARIANCE, MEASUREMENT.present))


@EACH
def test_covariance_beside_each_of_some_objects(noise):
    each, present = MEASUREMENT.unsqueeze(), MEASUREMENT.present[:, None]
    signals = torch.stack([SIGNAL, 2 * SIGNAL, 0 * SIGNAL], 1)
    found = Interfered(noise, COLUMNS).covariance(signals, VARIANCE[:, None], each.present)
    for n in range(3):
        expected = noise.covariance(signals[:, n] + ADDED, VARIANCE, present[:, 0])
        torch.testing.assert_close(found[:, n], expected)


@EACH
def test_update(noise):
    prior = any_level(BATCH, TONES)
    found = Interfered(noise, COLUMNS).update(prior, MEASUREMENT, SIGNAL)
    expected = noise.update(prior, MEASUREMENT, SIGNAL + ADDED)
    torch.testing.assert_close(found.log_weight, expected.log_weight)
    assert torch.equal(found.variance, expected.variance)


@EACH
def test_log_likelihood(noise):
    found = Interfered(noise, COLUMNS).log_likelihood(MEASUREMENT, OBJECTS, VARIANCE)
    together = torch.cat([OBJECTS, COLUMNS], -1)
    torch.testing.assert_close(found, noise.log_likelihood(MEASUREMENT, together, VARIANCE))


@EACH
def test_log_likelihood_of_several_configurations(noise):
    """Draws of configurations stand behind the batch."""
    draws = torch.stack([OBJECTS, 0.5 * OBJECTS], 1)
    found = Interfered(noise, COLUMNS).log_likelihood(MEASUREMENT.unsqueeze(), draws, VARIANCE[:, None])
    for n in range(2):
        alone = Interfered(noise, COLUMNS).log_likelihood(MEASUREMENT, draws[:, n], VARIANCE)
        torch.testing.assert_close(found[:, n], alone)


@EACH
def test_a_sequence_is_in_a_batch_what_it_is_alone(noise):
    together = Interfered(noise, COLUMNS).covariance(SIGNAL, VARIANCE, MEASUREMENT.present)
    for b in range(BATCH):
        alone = Interfered(noise, COLUMNS).select([b])
        found = alone.covariance(SIGNAL[b : b + 1], VARIANCE[b : b + 1], MEASUREMENT.present[b : b + 1])
        assert torch.equal(found, together[b : b + 1])
