import math

import pytest
import torch
from oracles.arrays import (
    complex_normal,
    direct_log_likelihood,
    random_covariance,
    sample_covariance,
)
from torch.distributions import MultivariateNormal

from torchdt.core.linalg import NumericalError
from torchdt.model.measurement import (
    from_covariance,
    from_snapshots,
    gaussian_log_likelihood,
    low_rank_log_likelihood,
    mask_covariance,
)

TONES, SNAPSHOTS, SENSORS = 2, 3, 5


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(5)


@pytest.fixture
def snapshots(rng) -> torch.Tensor:
    return complex_normal(rng, 4, TONES, SNAPSHOTS, SENSORS)


@pytest.fixture
def covariance(rng) -> torch.Tensor:
    return random_covariance(rng, 4, TONES, sensors=SENSORS)


def test_likelihood_equals_the_real_multivariate_normal(snapshots, covariance):
    """A circular complex vector is a real one of twice the length."""
    re, im = covariance.real, covariance.imag
    real_covariance = 0.5 * torch.cat([torch.cat([re, -im], -1), torch.cat([im, re], -1)], -2)
    normal = MultivariateNormal(torch.zeros(2 * SENSORS).double(), real_covariance.unsqueeze(-3))
    expected = normal.log_prob(torch.cat([snapshots.real, snapshots.imag], -1)).sum(-1)
    found = gaussian_log_likelihood(from_snapshots(snapshots), covariance)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("num_snapshots", [1, SENSORS, 9])
def test_more_snapshots_than_sensors(rng, num_snapshots):
    snapshots = complex_normal(rng, TONES, num_snapshots, SENSORS)
    covariance = random_covariance(rng, TONES, sensors=SENSORS)
    measurement = from_snapshots(snapshots)
    assert measurement.factor.shape[-1] == min(num_snapshots, SENSORS)
    found = gaussian_log_likelihood(measurement, covariance)
    torch.testing.assert_close(found, direct_log_likelihood(snapshots, covariance), rtol=1e-12, atol=1e-12)
    energy = snapshots.abs().square().sum((-2, -1)) / num_snapshots
    torch.testing.assert_close(measurement.energy, energy)


@pytest.mark.parametrize("num_snapshots", [3, 9])
def test_covariance_says_the_same_as_its_snapshots(rng, num_snapshots):
    snapshots = complex_normal(rng, TONES, num_snapshots, SENSORS)
    first, second = from_snapshots(snapshots), from_covariance(sample_covariance(snapshots), num_snapshots)
    torch.testing.assert_close(first.factor @ first.factor.mH, second.factor @ second.factor.mH)
    torch.testing.assert_close(first.num_snapshots, second.num_snapshots)
    covariance = random_covariance(rng, TONES, sensors=SENSORS)
    torch.testing.assert_close(
        gaussian_log_likelihood(first, covariance),
        gaussian_log_likelihood(second, covariance),
        rtol=1e-12,
        atol=1e-12,
    )


@pytest.mark.parametrize("how_much", [1.0, 0.6])
def test_a_missing_snapshot_is_dropped(snapshots, covariance, how_much):
    broken = snapshots.clone()
    broken[:, :, 1, : math.ceil(how_much * SENSORS)] = torch.nan
    found = gaussian_log_likelihood(from_snapshots(broken), covariance)
    expected = direct_log_likelihood(snapshots[:, :, [0, 2]], covariance)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


def check_sensor_dropped(measurement, snapshots, covariance, kept):
    signal = covariance - 0.3 * torch.eye(SENSORS, dtype=torch.float64)
    noise = torch.full(covariance.shape[:-2], 0.3, dtype=torch.float64)
    found = gaussian_log_likelihood(measurement, mask_covariance(signal, noise, measurement.present))
    smaller = covariance[..., kept, :][..., kept]
    expected = direct_log_likelihood(snapshots[..., kept], smaller)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)
    assert measurement.present.sum(-1).unique().tolist() == [len(kept)]


@pytest.mark.parametrize("num_columns", [1, 3, SENSORS + 2])
def test_few_columns_say_the_same_as_their_covariance(rng, snapshots, num_columns):
    columns = 10 * complex_normal(rng, TONES, SENSORS, num_columns)
    noise = torch.linspace(0.1, 2.0, TONES, dtype=torch.float64)
    broken = snapshots.clone()
    broken[0, 1:, :, 3], broken[-1, 0] = torch.nan, torch.nan
    measurement = from_snapshots(broken)
    covariance = mask_covariance(columns @ columns.mH, noise, measurement.present)
    found = low_rank_log_likelihood(measurement, columns, noise)
    torch.testing.assert_close(found, gaussian_log_likelihood(measurement, covariance), rtol=1e-10, atol=0)


@pytest.mark.parametrize("steps", [[0, 1, 2], [1]])
def test_a_dead_channel_is_a_smaller_array(snapshots, covariance, steps):
    broken = snapshots.clone()
    broken[:, :, steps, 3] = torch.nan
    check_sensor_dropped(from_snapshots(broken), snapshots, covariance, [0, 1, 2, 4])


def test_a_dead_channel_and_a_missing_snapshot(snapshots, covariance):
    broken = snapshots.clone()
    broken[..., 0] = torch.nan
    broken[:, :, 2] = torch.nan
    check_sensor_dropped(from_snapshots(broken), snapshots[:, :, :2], covariance, [1, 2, 3, 4])


def test_a_dead_channel_of_a_covariance(snapshots, covariance):
    sample = sample_covariance(snapshots)
    sample[..., 2, :] = torch.nan
    sample[..., :, 2] = torch.nan
    check_sensor_dropped(from_covariance(sample, SNAPSHOTS), snapshots, covariance, [0, 1, 3, 4])


@pytest.mark.parametrize("kind", ["snapshots", "covariance"])
def test_everything_missing_has_no_influence(snapshots, covariance, kind):
    missing = torch.full_like(snapshots, torch.nan)
    measurement = from_snapshots(missing)
    if kind == "covariance":
        measurement = from_covariance(torch.full_like(covariance, torch.nan), 3.0)
    noise = torch.full(covariance.shape[:-2], 0.7, dtype=torch.float64)
    masked = mask_covariance(covariance, noise, measurement.present)
    assert gaussian_log_likelihood(measurement, masked).eq(0).all()
    assert measurement.energy.eq(0).all()


def test_tempering_raises_the_likelihood_to_a_power(snapshots, covariance):
    measurement = from_snapshots(snapshots)
    power = torch.tensor([0.3, 0.8], dtype=torch.float64)
    found = gaussian_log_likelihood(measurement.tempered(power), covariance)
    torch.testing.assert_close(found, power * gaussian_log_likelihood(measurement, covariance))


def test_steps_and_the_object_dimension(snapshots):
    measurement = from_snapshots(snapshots)
    step = measurement.at(2)
    torch.testing.assert_close(step.factor, from_snapshots(snapshots[2]).factor)
    assert [tuple(t.shape) for t in measurement.unsqueeze()] == [
        (4, 1, TONES, SENSORS, SNAPSHOTS),
        (4, 1, TONES),
        (4, 1, TONES, SENSORS),
    ]


def test_an_indefinite_covariance_is_named(snapshots, covariance):
    covariance[2, 1] -= 50 * torch.eye(SENSORS)
    with pytest.raises(NumericalError, match=r"measurement covariance: .*\(2, 1\)"):
        gaussian_log_likelihood(from_snapshots(snapshots), covariance)


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_noise_below_the_rounding_of_the_signal_counts_as_that(dtype):
    """Sums of responses without any noise can be factorised; noise above their rounding is left as it is."""
    rng = torch.Generator().manual_seed(1)
    response = torch.randn(200, 2, 8, 3, dtype=dtype, generator=rng)
    signal, present = response @ response.mH, torch.ones(200, 2, 8, dtype=dtype.to_real())
    silent = torch.zeros(200, 2, dtype=dtype.to_real())
    assert (
        torch.linalg.cholesky_ex(mask_covariance(signal, silent, present).to(torch.complex128))[1].eq(0).all()
    )
    loud = torch.full_like(silent, 1e-4)
    eye = torch.eye(8, dtype=dtype)
    torch.testing.assert_close(mask_covariance(signal, loud, present), signal + 1e-4 * eye, rtol=0, atol=0)
