"""The likelihood of one more object at some levels, against dense covariances one by one."""

import math

import pytest
import torch
from oracles.arrays import complex_normal, random_covariance

from torchdt.filter.bp.rank_one import statistics, whiten
from torchdt.filter.intensity.levels import CEILING, level_log_likelihood
from torchdt.filter.intensity.settings import Intensity
from torchdt.model.measurement import Measurement, from_snapshots, gaussian_log_likelihood

F64 = torch.float64
TONES, CELLS, SENSORS, SNAPSHOTS = 3, 5, 6, 2


def dense(measurement: Measurement, background, response, power, share):
    """`(L, C)`: one cell, level, tone and power after another."""
    found = torch.zeros(len(share), response.shape[1], dtype=F64)
    mask = measurement.present[:, :, None] * measurement.present[:, None, :]
    before = gaussian_log_likelihood(measurement, background)
    for level, row in enumerate(share):
        for cell in range(response.shape[1]):
            for tone in range(len(power)):
                total = row[0].item()
                for gamma, weight in zip(power[tone], row[1:], strict=True):
                    a = response[tone, cell]
                    after = background + gamma * mask * torch.outer(a, a.conj())
                    ratio = gaussian_log_likelihood(measurement, after)[tone] - before[tone]
                    total += weight.item() * math.exp(ratio)
                found[level, cell] += math.log(total)
    return found


@pytest.mark.parametrize("missing", ["nothing", "sensors", "a tone"])
def test_is_the_sum_over_dense_covariances(missing):
    rng = torch.Generator().manual_seed(0)
    background = random_covariance(rng, TONES, sensors=SENSORS)
    data = complex_normal(rng, TONES, SNAPSHOTS, SENSORS)
    if missing == "sensors":
        data[0, :, 2], data[1, :, 4:] = torch.nan, torch.nan
    elif missing == "a tone":
        data[1] = torch.nan
    measurement = from_snapshots(data)
    mask = measurement.present
    keep = mask[:, :, None] * mask[:, None, :]
    background = background * keep + torch.diag_embed(0.7 * (1 - mask)).to(background)
    response = complex_normal(rng, TONES, CELLS, SENSORS)
    settings = Intensity(levels=3)
    level, share = settings.tone_levels(settings.level(torch.zeros((), dtype=F64)))
    power = level * torch.tensor([0.2, 1.0, 0.6], dtype=F64)[:, None]
    s, q = statistics(whiten(measurement, background), response)
    found = level_log_likelihood(s, q, measurement.num_snapshots, power, share)
    torch.testing.assert_close(found, dense(measurement, background, response, power, share))


def test_a_batch_is_one_after_the_other():
    rng = torch.Generator().manual_seed(1)
    s, q = (torch.rand(4, 2, TONES, CELLS, generator=rng, dtype=F64) for _ in range(2))
    count = torch.tensor([[1.0, 0.0, 3.0]], dtype=F64).expand(4, 2, TONES)
    power = torch.rand(4, 2, TONES, 2, generator=rng, dtype=F64)
    share = torch.rand(5, 3, generator=rng, dtype=F64).softmax(-1)
    found = level_log_likelihood(s, q, count, power, share)
    assert found.shape == (4, 2, 5, CELLS)
    expected = level_log_likelihood(s[2, 1], q[2, 1], count[2, 1], power[2, 1], share)
    torch.testing.assert_close(found[2, 1], expected)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_however_strong_a_source_is_the_numbers_stay_finite(dtype):
    s, q = torch.full((1, 1), 1e6, dtype=dtype), torch.full((1, 1), 1e12, dtype=dtype)
    power, share = torch.ones(1, 1, dtype=dtype), torch.tensor([[0.1, 0.9]], dtype=dtype)
    found = level_log_likelihood(s, q, torch.ones(1, dtype=dtype), power, share)
    assert found.item() == pytest.approx(CEILING + math.log(0.9), rel=1e-5)


@pytest.mark.parametrize("levels", [1, 2, 5])
def test_shares_of_a_level_have_its_mean_power(levels):
    """For a factor of the square root of ten between levels, which is the default's."""
    settings = Intensity(levels=levels, lowest=0.1, highest=0.1 * 10 ** ((levels - 1) / 2) * (1 + 1e-9))
    level = settings.level(torch.zeros((), dtype=F64))
    around, share = settings.tone_levels(level)
    torch.testing.assert_close(share.sum(-1), torch.ones(levels, dtype=F64))
    torch.testing.assert_close(around[1:-1], level)
    if levels > 1:
        torch.testing.assert_close(share[:, 1:] @ around, level, rtol=0.01, atol=0)
