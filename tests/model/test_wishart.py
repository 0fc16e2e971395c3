import math

import pytest
import torch
from oracles.arrays import complex_normal, random_covariance
from torch import Tensor
from torch.distributions import Gamma

from torchdt.core.linalg import NumericalError
from torchdt.model.measurement import from_covariance, gaussian_log_likelihood
from torchdt.model.wishart import log_normaliser

F64 = torch.float64
GIVEN = 7.0


@pytest.fixture
def rng() -> torch.Generator:
    return torch.Generator().manual_seed(3)


def draws(rng: torch.Generator, covariance: Tensor, count: int, number: int) -> Tensor:
    """Sample covariances `(number, I, M, M)` of `count` snapshots of `covariance` `(I, M, M)`."""
    white = complex_normal(rng, number, covariance.shape[0], covariance.shape[-1], count)
    coloured = torch.linalg.cholesky(covariance) @ white
    return coloured @ coloured.mH / count


def log_density(sample: Tensor, covariance: Tensor, count: Tensor | float) -> Tensor:
    """`log f(R | C, J)` as the tracker makes it, each tone alone."""
    measurement = from_covariance(sample, GIVEN)
    count = torch.as_tensor(count, dtype=F64)
    likelihood = gaussian_log_likelihood(measurement.recounted(count), covariance)
    reference = (GIVEN - sample.shape[-1]) * torch.linalg.slogdet(sample)[1]
    return likelihood + log_normaliser(measurement, count) + reference


@pytest.mark.parametrize("count", [0.4, 1.0, 17.5])
def test_one_sensor_has_the_gamma_density(rng, count):
    power = torch.tensor([[0.5], [2.0]], dtype=F64)
    sample = torch.rand(2, 1, 1, 1, generator=rng, dtype=F64).to(torch.complex128) + 0.1
    found = log_density(sample, power[..., None, None].to(torch.complex128), count)
    expected = Gamma(torch.tensor(count, dtype=F64), count / power).log_prob(sample[..., 0, 0].real)
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("count", [3.7, 12.0])
def test_density_equals_that_of_the_factor_of_independent_entries(rng, count):
    """Bartlett: with `W = T T^H` the `|T_ii|^2` are Gamma of shape `J - i`, what is below standard normal."""
    covariance = random_covariance(rng, 1, sensors=4)
    sample = draws(rng, covariance, 9, 5)
    lower = torch.linalg.cholesky(covariance)
    white = torch.linalg.solve_triangular(lower, sample * count, upper=False)
    white = torch.linalg.solve_triangular(lower, white.mH, upper=False)
    factor = torch.linalg.cholesky(white)
    diagonal = factor.diagonal(dim1=-2, dim2=-1).real
    index = torch.arange(4, dtype=F64)
    below = torch.tril(factor, -1).abs().square().sum((-2, -1)) + 6 * math.log(math.pi)
    of_factor = (Gamma(count - index, torch.ones(4, dtype=F64)).log_prob(diagonal**2)).sum(-1) - below
    # |T_ii|^2 to T_ii, T to W, W to S = L W L^H, S to R = S / J.
    to_white = (2 * diagonal).log().sum(-1) - (math.log(2) + (7 - 2 * index) * diagonal.log()).sum(-1)
    to_sample = -4 * torch.linalg.slogdet(covariance)[1] + 16 * math.log(count)
    torch.testing.assert_close(log_density(sample, covariance, count), of_factor + to_white + to_sample)


def test_the_true_count_is_the_likeliest(rng):
    """The mean score at the true count is zero: within 4.5 standard errors, false alarm 7e-6."""
    covariance = random_covariance(rng, 1, sensors=3)
    sample = draws(rng, covariance, 25, 2000)
    scores = []
    for count in (25.0, 30.0, 20.0):
        each = torch.full((2000, 1), count, dtype=F64, requires_grad=True)
        (slope,) = torch.autograd.grad(log_density(sample, covariance, each).sum(), each)
        scores.append(slope)
    error = scores[0].std() / 2000**0.5
    assert scores[0].mean().abs() < 4.5 * error
    assert scores[1].mean() < -10 * error
    assert scores[2].mean() > 10 * error


def test_missing_sensors_count_as_absent(rng):
    sample = draws(rng, random_covariance(rng, 2, sensors=5), 20, 3)
    kept = [0, 2, 3]
    gone = sample.clone()
    gone[..., [1, 4], :] = gone[..., :, [1, 4]] = torch.nan
    found = log_normaliser(from_covariance(gone, GIVEN), torch.tensor(11.0, dtype=F64))
    expected = log_normaliser(
        from_covariance(sample[..., kept, :][..., kept], GIVEN), torch.tensor(11.0, dtype=F64)
    )
    torch.testing.assert_close(found, expected)


def test_steps_without_data_have_none(rng):
    sample = draws(rng, random_covariance(rng, 2, sensors=3), 20, 3)
    sample[1] = torch.nan
    measurement = from_covariance(sample, GIVEN)
    count = torch.tensor(11.0, dtype=F64, requires_grad=True)
    found = log_normaliser(measurement, count)
    assert found[1].eq(0).all()
    assert found[[0, 2]].ne(0).all()
    assert torch.autograd.grad(found.sum(), count)[0].isfinite()
    again = measurement.recounted(count)
    assert again.num_snapshots[1].eq(0).all()
    assert again.factor.isfinite().all()


def test_the_unit_counts_as_for_the_given_number_of_snapshots(rng):
    sample = draws(rng, random_covariance(rng, 1, sensors=3), 20, 2)
    count = torch.tensor(11.0, dtype=F64)

    def total(unit: float) -> Tensor:
        measurement = from_covariance(sample / unit**2, GIVEN)
        covariance = torch.eye(3, dtype=torch.complex128).expand(2, 1, 3, 3) / unit**2
        likelihood = gaussian_log_likelihood(measurement.recounted(count), covariance)
        return likelihood + log_normaliser(measurement, count)

    torch.testing.assert_close(
        total(2.0) - total(1.0), torch.full((2, 1), 2 * 3 * GIVEN * math.log(2.0)).double()
    )


@pytest.mark.parametrize("count", [2.0, 1.0, math.nan])
def test_too_few_snapshots_for_a_density_are_named(rng, count):
    measurement = from_covariance(draws(rng, random_covariance(rng, 1, sensors=3), 20, 2), GIVEN)
    with pytest.raises(NumericalError, match=r"effective count: .* of 3 sensors, .* above 2"):
        log_normaliser(measurement, torch.tensor(count, dtype=F64))


def test_a_sample_covariance_of_few_snapshots_is_named(rng):
    measurement = from_covariance(draws(rng, random_covariance(rng, 1, sensors=3), 2, 2), GIVEN)
    with pytest.raises(NumericalError, match="sample covariance: not positive definite"):
        log_normaliser(measurement, torch.tensor(11.0, dtype=F64))
