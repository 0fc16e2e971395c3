"""Environment and positions fitted together, against plain least squares and a known truth."""

import numpy as np
import pytest
import torch
from oracles.arrays import complex_normal

from torchdt.calibration.focalise import Focus, focalise, leftover
from torchdt.model.measurement import from_snapshots

pytestmark = pytest.mark.slow
F64 = torch.float64
SCALE = torch.tensor([6.25, 0.5], dtype=F64)
NOMINAL = torch.zeros(4, dtype=F64)
ALL, NOTHING = torch.ones(4, dtype=torch.bool), torch.zeros(4, dtype=torch.bool)


@pytest.fixture(scope="module")
def linear(family):
    return family.linearise(NOMINAL)


def leftover_of(*arguments) -> torch.Tensor:
    return leftover(*arguments)[0]


def random_data(seed: int, *shape: int):
    """Unit-norm responses `(S, N, I, M)` and snapshots `(S, I, J, M)`."""
    rng = torch.Generator().manual_seed(seed)
    steps, sources, tones, snapshots, sensors = shape
    response = complex_normal(rng, steps, sources, tones, sensors)
    response = response / torch.linalg.vector_norm(response, dim=-1, keepdim=True)
    return response, complex_normal(rng, steps, tones, snapshots, sensors)


def residual(response: np.ndarray, snapshots: np.ndarray) -> float:
    """Share left by least squares of `(J, M)` snapshots on `(N, M)` responses."""
    amplitude = np.linalg.lstsq(response.T, snapshots.T, rcond=None)[0]
    return np.linalg.norm(snapshots.T - response.T @ amplitude) ** 2 / np.linalg.norm(snapshots) ** 2


def test_leftover_share_is_the_residual_of_least_squares():
    """Sources that are not active and sensors that are missing take no part."""
    response, z = random_data(1, 4, 3, 2, 5, 8)
    active = torch.tensor([[1, 1, 1], [1, 0, 1], [0, 0, 1], [0, 0, 0]], dtype=torch.bool)
    z[1, 0, :, 3] = torch.nan
    z[2, 1, :, 6:] = torch.nan
    found = leftover_of(response, active, from_snapshots(z))
    assert found.shape == (4, 2)
    for s, i in np.ndindex(4, 2):
        heard = ~z[s, i].isnan().any(0)
        expected = residual(response[s, active[s], i][:, heard].numpy(), z[s, i][:, heard].numpy())
        assert float(found[s, i]) == pytest.approx(expected, rel=1e-4), (s, i)
    assert (1 - found[3]).abs().max() < 1e-12  # nothing to explain it with


def test_leftover_share_of_what_is_explained_and_of_silence():
    response, z = random_data(2, 2, 2, 2, 3, 8)
    active = torch.ones(2, 2, dtype=torch.bool)
    z[0] = torch.einsum("ijn,nim->ijm", complex_normal(torch.Generator(), 2, 3, 2), response[0])
    z[1, 1] = torch.nan
    found = leftover_of(response, active, from_snapshots(z))
    assert (found[0] < 1e-4).all()
    assert (found > 0).all()
    assert found[1, 1] == 1


def test_two_sources_on_the_same_spot_do_not_break_it():
    response, z = random_data(3, 1, 2, 2, 3, 8)
    response[:, 1] = response[:, 0]
    found = leftover_of(response, torch.ones(1, 2, dtype=torch.bool), from_snapshots(z))
    for i in range(2):
        assert float(found[0, i]) == pytest.approx(
            residual(response[0, :1, i].numpy(), z[0, i].numpy()), rel=1e-4
        )


def off_by(truth: torch.Tensor, metres: tuple[float, float], seed: int) -> torch.Tensor:
    """Positions that miss the true ones, to either side."""
    sign = torch.randn(truth.shape, generator=torch.Generator().manual_seed(seed), dtype=F64).sign()
    return truth + sign * torch.tensor(metres, dtype=F64)


@pytest.fixture(scope="module")
def fit(linear, family, scene):
    """A fit of both sources in all steps."""
    active = torch.ones(8, 2, dtype=torch.bool)

    def fit(start, theta=NOMINAL, free=ALL, **options) -> Focus:
        return focalise(
            linear, family.prior_std, theta, start, active, scene.measurement, SCALE, free, **options
        )

    return fit


@pytest.fixture(scope="module")
def fitted(fit, scene) -> Focus:
    """Started in the nominal environment, 15 m and 0.7 m off."""
    return fit(off_by(scene.truth, (15.0, 0.7), 1))


def test_finds_environment_and_positions(fitted, linear, family, scene):
    """The linearised field and the noise leave errors of 0.002 degrees, 4 cm of water and 2.4 m of range."""
    assert float(fitted.theta[2] - scene.theta[2]) == pytest.approx(0, abs=0.1)
    assert float(fitted.theta[3] - scene.theta[3]) == pytest.approx(0, abs=0.2)
    torch.testing.assert_close(fitted.theta[:2], scene.theta[:2], rtol=0.0, atol=0.2)
    error = (fitted.position - scene.truth).abs()
    assert error[..., 0].max() < 5
    assert error[..., 1].max() < 0.3
    # What is left is noise: 1 % of it per source and sensor, less what the fit takes along.
    assert fitted.leftover.mean() < 0.02
    active = torch.ones(8, 2, dtype=torch.bool)
    torch.testing.assert_close(
        fitted.leftover, leftover_of(linear(fitted.theta)(fitted.position), active, scene.measurement)
    )
    # Three snapshots of 21 sensors, two sources.
    log_likelihood = -(3 * (21 - 2) * fitted.leftover.log()).sum()
    log_prior = -0.5 * (fitted.theta / family.prior_std).square().sum()
    torch.testing.assert_close(fitted.log_posterior, log_likelihood + log_prior)


def test_reaches_the_same_optimum_from_farther_off(fit, fitted, scene):
    """From 35 m and 1.5 m; a fit that starts with every detail stays 7 nats below."""
    farther = fit(off_by(scene.truth, (35.0, 1.5), 0))
    assert float(farther.log_posterior) == pytest.approx(float(fitted.log_posterior), abs=0.5)


def test_keeps_the_environment_on_demand(fit, fitted, linear, scene):
    theta = torch.tensor([0.5, -0.2, 0.3, 0.1], dtype=F64)
    start = scene.truth + torch.tensor([15.0, 0.7], dtype=F64)
    fixed = fit(start, theta, free=NOTHING)
    torch.testing.assert_close(fixed.theta, theta, rtol=0.0, atol=1e-15)
    assert (fixed.position - start).abs().max() > 1
    assert not fixed.position.requires_grad
    assert not fixed.theta.requires_grad
    before = leftover_of(linear(theta)(start), torch.ones(8, 2, dtype=torch.bool), scene.measurement)
    assert fixed.leftover.log().mean() < before.log().mean()
    assert fitted.log_posterior > fixed.log_posterior + 500


def test_absent_sources_and_silent_steps_stay_where_they_are(linear, family, scene):
    start = scene.truth + torch.tensor([15.0, 0.7], dtype=F64)
    active = torch.ones(8, 2, dtype=torch.bool)
    active[2, 1] = False
    silent = scene.measurement._replace(
        factor=scene.measurement.factor.clone(), num_snapshots=scene.measurement.num_snapshots.clone()
    )
    silent.factor[5], silent.num_snapshots[5] = 0, 0
    fixed = focalise(linear, family.prior_std, NOMINAL, start, active, silent, SCALE, NOTHING, iterations=20)
    moved = (fixed.position - start).abs().amax(-1)
    assert moved[2, 1] == 0
    assert moved[5].eq(0).all()
    assert (moved[[0, 1, 3, 4, 6, 7]] > 0).all()
    assert fixed.leftover.isfinite().all()
