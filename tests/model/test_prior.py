import pytest
import torch
from oracles.arrays import complex_normal, sample_covariance

from torchdt.core.errors import InputError
from torchdt.model.measurement import from_covariance, from_snapshots
from torchdt.model.prior import data_priors, data_scale

STEPS, TONES, SNAPSHOTS, SENSORS = 6, 2, 3, 4


@pytest.fixture
def snapshots() -> torch.Tensor:
    return complex_normal(torch.Generator().manual_seed(1), 2, STEPS, TONES, SNAPSHOTS, SENSORS)


@pytest.mark.parametrize("unit", [1e-20, 1e-3, 1.0, 1e20])
@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_scale_is_the_root_mean_square(snapshots, unit, dtype):
    expected = snapshots.abs().square().mean((1, 2, 3, 4)).sqrt() * unit
    scale = data_scale((snapshots * unit).to(dtype), is_covariance=False)
    torch.testing.assert_close(scale.double(), expected, rtol=1e-5, atol=0)


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_scale_of_a_covariance_is_that_of_its_snapshots(snapshots, unit):
    expected = data_scale(snapshots * unit, is_covariance=False)
    found = data_scale(sample_covariance(snapshots * unit), is_covariance=True)
    torch.testing.assert_close(found, expected)


def test_scale_leaves_out_what_is_missing(snapshots):
    broken = snapshots.clone()
    broken[0, 2:] = torch.nan
    broken[1] = torch.nan
    scale = data_scale(broken, is_covariance=False)
    torch.testing.assert_close(scale[0], data_scale(snapshots[:1, :2], is_covariance=False)[0])
    assert scale[1] == 1


@pytest.mark.parametrize(("is_covariance", "key"), [(False, "snapshots"), (True, "covariance")])
def test_zeros_are_named(snapshots, is_covariance, key):
    data = sample_covariance(snapshots) if is_covariance else snapshots.clone()
    data[1] = 0
    with pytest.raises(InputError, match=f"key '{key}': found only zeros, expected a signal or noise"):
        data_scale(data, is_covariance)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 30.0])
def test_priors_follow_the_unit(snapshots, unit):
    one, other = data_priors(from_snapshots(snapshots)), data_priors(from_snapshots(unit * snapshots))
    torch.testing.assert_close(other.power_max, unit**2 * one.power_max)
    torch.testing.assert_close(other.noise_max, unit**2 * one.noise_max)


def test_priors_cover_the_data_and_ignore_a_silent_tone_and_a_dead_channel(snapshots):
    broken = snapshots.clone()
    broken[:, :, 1] = torch.nan
    broken[..., 3] = torch.nan
    priors = data_priors(from_snapshots(broken))
    energy = snapshots[:, :, 0, :, :3].abs().square().sum(-1).mean(-1)  # per snapshot
    torch.testing.assert_close(priors.noise_max[:, 0], 2 * energy.quantile(0.5, dim=1) / 3)
    torch.testing.assert_close(priors.power_max[:, 0], 2 * energy.quantile(0.99, dim=1))
    assert (priors.power_max > 0).all()
    assert (priors.noise_max > 0).all()


def test_priors_of_covariances_equal_those_of_snapshots(snapshots):
    one = data_priors(from_snapshots(snapshots))
    other = data_priors(from_covariance(sample_covariance(snapshots), SNAPSHOTS))
    torch.testing.assert_close(one.power_max, other.power_max)
    torch.testing.assert_close(one.noise_max, other.noise_max)
