import math

import numpy as np
import pytest
import torch
from oracles.arrays import complex_normal, direct_log_likelihood
from oracles.detectors import describe_points, off
from oracles.line_array import make_field, make_region
from scipy.optimize import minimize

from torchdt.baselines.detect.describe import describe, log_ratio, polish, project_out, ratio
from torchdt.field.stacked import StackedField
from torchdt.filter.bp.rank_one import peak_log_likelihood_ratio
from torchdt.model.measurement import Measurement, from_snapshots

F64 = torch.float64
FIELD, REGION = make_field(), make_region()


def bearings(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)[:, None]


def simulate(seed: int, *sources: float, steps: int = 1, eta: float = 1e-2, J: int = 3, power: float = 1.0):
    """Snapshots (steps, I, J, M) of Gaussian sources."""
    rng = torch.Generator().manual_seed(seed)
    z = eta**0.5 * complex_normal(rng, steps, 2, J, 8)
    for source in sources:
        z = z + power**0.5 * complex_normal(rng, steps, 2, J, 1) * FIELD(bearings(source))[0][:, None]
    return z


def describe_at(z: torch.Tensor, *sources: float, present=None):
    """Points at bearings, the same for all steps of snapshots (steps, I, J, M)."""
    position = bearings(*sources).expand(len(z), -1, -1)
    present = torch.ones(position.shape[:-1], dtype=torch.bool) if present is None else present
    return describe(FIELD(position), position, present, from_snapshots(z))


def best_ratio(a: np.ndarray, z: np.ndarray) -> float:
    """Likelihood ratio of a response (n,) in snapshots (J, n), by search over power and noise variance."""
    signal, data = torch.tensor(np.outer(a, a.conj())), torch.tensor(z)
    eye = torch.eye(len(a), dtype=signal.dtype)

    def misfit(logs):
        return -float(direct_log_likelihood(data, math.exp(logs[0]) * signal + math.exp(logs[1]) * eye))

    options = {"xatol": 1e-7, "fatol": 1e-9}
    level = math.log(np.linalg.norm(z) ** 2 / z.size)
    best = minimize(misfit, [level - 1, level - 2], method="Nelder-Mead", options=options)
    return misfit([-50, level]) - best.fun


def test_log_ratio_is_the_best_over_power_and_noise_variance():
    rng = torch.Generator().manual_seed(1)
    for n, J, power in ((8, 3, 4.0), (5, 1, 30.0), (2, 6, 2.0), (8, 2, 0.5)):
        a = complex_normal(rng, n).numpy()
        z = (complex_normal(rng, J, n) + power**0.5 * complex_normal(rng, J, 1) * torch.tensor(a)).numpy()
        share = np.linalg.norm(z @ a.conj()) ** 2 / np.linalg.norm(a) ** 2 / np.linalg.norm(z) ** 2
        assert n * share > 1
        found = log_ratio(*(torch.tensor(float(v), dtype=F64) for v in (J, n, share)))
        assert found.item() == pytest.approx(best_ratio(a, z), rel=1e-5)


def test_log_ratio_of_many_sensors_is_that_of_known_noise():
    x = torch.tensor([0.5, 1.0, 1.5, 3.0, 10.0], dtype=F64)
    J, n = torch.tensor(3.0, dtype=F64), torch.tensor(1e7, dtype=F64)
    known, _ = peak_log_likelihood_ratio(J, torch.ones_like(x), J * x)
    torch.testing.assert_close(log_ratio(J, n, x / n), known, rtol=1e-5, atol=1e-12)


def test_log_ratio_stays_finite():
    free = torch.tensor([-2.0, 0.0, 1.0, 2.0, 8.0])[:, None]
    share = torch.tensor([0.0, 0.1, 0.5, 1.0, 1.0 + 1e-6])
    value = log_ratio(torch.tensor(3.0), free, share)
    assert value.isfinite().all()
    assert (value >= 0).all()
    assert value[:3].eq(0).all()
    assert (value[3:, -2:] > 10).all()


def test_powers_noise_and_strengths_are_those_of_explicit_projections():
    z = simulate(2, -31.0, 14.6, 20.0)
    found = describe_at(z, 14.6, -31.0, 20.0)
    order = [(bearings(14.6, -31.0, 20.0)[:, 0] == x).nonzero().item() for x in found.position[0, :, 0]]
    response = FIELD(bearings(14.6, -31.0, 20.0))
    power, noise, share = (torch.tensor(v) for v in describe_points(response.numpy(), z[0].numpy()))
    torch.testing.assert_close(found.power[0], power[order], rtol=1e-6, atol=0)
    torch.testing.assert_close(found.noise[0], noise, rtol=1e-6, atol=0)
    strength = log_ratio(torch.tensor(3.0, dtype=F64), torch.tensor(6.0, dtype=F64), share).sum(-1)
    torch.testing.assert_close(found.strength[0], strength[order], rtol=1e-6, atol=1e-9)
    assert found.strength[0].diff().le(0).all()


def test_strength_is_the_ratio_given_the_others():
    z = simulate(3, -31.0, 14.6)
    found = describe_at(z, -31.0, 14.6, 50.0)
    for n in range(3):
        others = torch.ones(1, 3, dtype=torch.bool)
        others[0, n] = False
        remainder = project_out(FIELD(found.position), others, from_snapshots(z))
        alone = ratio(remainder, FIELD(found.position[:, n])[:, :, None])
        torch.testing.assert_close(alone[:, 0], found.strength[:, n], rtol=1e-6, atol=1e-9)


def test_missing_sensors_and_absent_points_are_as_if_they_did_not_exist():
    z = simulate(4, -31.0, 14.6)
    z[..., 2] = torch.nan
    present = torch.tensor([[True, False, True]])
    found = describe_at(z, 14.6, 60.0, -31.0, present=present)
    heard = [m for m in range(8) if m != 2]
    response = FIELD(found.position[0, :2])[..., heard].numpy()
    power, noise, _ = (torch.tensor(v) for v in describe_points(response, z[0][..., heard].numpy()))
    torch.testing.assert_close(found.power[0, :2], power, rtol=1e-6, atol=0)
    torch.testing.assert_close(found.noise[0], noise, rtol=1e-6, atol=0)
    assert found.present.tolist() == [[True, True, False]]
    assert found.position[0, 2].item() == 60.0
    assert found.strength[0, 2] == 0


def test_tones_without_data_say_nothing():
    z = simulate(5, -31.0)
    z[:, 1] = torch.nan
    found = describe_at(z, -31.0, 14.6)
    heard = describe(
        FIELD(found.position)[..., :1, :], found.position, found.present, from_snapshots(z[:, :1])
    )
    torch.testing.assert_close(found.strength, heard.strength)
    assert found.power[..., 1].eq(0).all()
    assert found.noise[..., 1].eq(0).all()
    z[:] = torch.nan
    assert describe_at(z, -31.0).strength.eq(0).all()


def test_points_of_equal_responses_have_no_strength():
    z = simulate(6, -31.0, 14.6)
    single, double = describe_at(z, -31.0, 14.6), describe_at(z, -31.0, 14.6, 14.6)
    twice = double.position[0, :, 0] == 14.6
    assert twice.tolist() == [False, True, True]
    assert double.strength[0, twice].max() < 1e-3 * single.strength.min()
    torch.testing.assert_close(double.noise, single.noise * 6 / 5, rtol=1e-5, atol=0)


@pytest.mark.parametrize("number", [7, 8, 10])
def test_as_many_points_as_sensors_leave_nothing(number):
    found = describe_at(simulate(7, -31.0), *(-60.0 + 12 * n for n in range(number)))
    for values in found:
        assert values.isfinite().all()
    if number >= 8:
        assert (found.noise < 1e-6 * found.power.sum(-2)).all()


@pytest.mark.parametrize("scale", [1e-8, 1e5])
@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_the_unit_of_the_data_does_not_matter(scale, dtype):
    z = simulate(8, -31.0, 14.6).to(dtype)
    ours, theirs = describe_at(z, -31.0, 14.6, 50.0), describe_at(scale * z, -31.0, 14.6, 50.0)
    torch.testing.assert_close(theirs.strength, ours.strength, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(theirs.power, scale**2 * ours.power, rtol=1e-4, atol=0)
    torch.testing.assert_close(theirs.noise, scale**2 * ours.noise, rtol=1e-4, atol=0)


def test_single_precision_data_leave_the_noise_below_a_strong_source():
    """60 dB: squares in single precision would have lost the noise."""
    z = simulate(9, -31.0, eta=1e-6)
    double, single = describe_at(z, -31.0), describe_at(z.to(torch.complex64), -31.0)
    assert single.strength.dtype == torch.float32
    torch.testing.assert_close(single.noise.to(F64), double.noise, rtol=1e-2, atol=0)


def test_noise_and_power_are_unbiased():
    """1000 steps of 18 complex numbers per tone left to noise: a standard deviation of 0.75 %, so that 5 % is
    6.7 of them, 1e-10. A mean power over 3000 amplitudes has one of 1.8 % and exponential tails: below 15 %,
    8 of them, with 1e-11."""
    found = describe_at(simulate(10, -31.0, 14.6, steps=1000), -31.0, 14.6)
    np.testing.assert_allclose(found.noise.mean(0), 1e-2, rtol=0.05)
    np.testing.assert_allclose(found.power.mean((0, 1)), 1.0, rtol=0.15)


def test_polish_finds_the_peak_that_others_hide():
    z = simulate(11, -31.3, 14.6, 27.2, steps=4, eta=1e-4)
    start = bearings(-32.0, 13.3, 28.1).expand(4, -1, -1)
    present = torch.ones(4, 3, dtype=torch.bool)
    moved = polish(FIELD, REGION, start, present, from_snapshots(z))
    assert (moved - bearings(-31.3, 14.6, 27.2)).abs().max() < 0.2
    before, after = (describe(FIELD(x), x, present, from_snapshots(z)) for x in (start, moved))
    assert (after.noise < 0.2 * before.noise).all()


def test_polish_leaves_absent_points_and_keeps_points_apart():
    z = simulate(12, 18.3, steps=4, eta=1e-4)
    start = bearings(15.6, 21.0, -31.0).expand(4, -1, -1)
    present = torch.tensor([True, True, False]).expand(4, 3)
    free, apart = (polish(FIELD, REGION, start, present, from_snapshots(z), s) for s in (0.0, 2.5))
    for moved in (free, apart):
        assert (moved[:, 2] == start[:, 2]).all()
        assert not (moved[:, :2] == start[:, :2]).all()
    assert ((free[:, 0] - free[:, 1]).abs() < 4.9).any()
    assert ((apart[:, 0] - apart[:, 1]).abs() >= 2.5 * 2 - 0.01).all()


def test_a_step_does_not_depend_on_the_others_of_a_batch():
    z = simulate(13, -31.3, 14.6, steps=4).reshape(2, 2, 2, 3, 8)
    z[0, 1, 0, :, 3] = torch.nan
    z[1, 0, 1] = torch.nan
    measurement = from_snapshots(z)
    start = bearings(-32.0, 13.3, 40.0).expand(2, 2, -1, -1)
    present = torch.tensor([[[True, True, False], [True] * 3], [[False, True, False], [False] * 3]])
    other = make_field()
    other._cycles *= 1.05
    field = StackedField([FIELD, other])
    moved = polish(field, REGION, start, present, measurement)
    together = describe(field(moved), moved, present, measurement)
    for b, one in enumerate(field.fields):
        for k in range(2):
            part = Measurement(*(t[b, k] for t in measurement))
            alone = polish(one, REGION, start[b, k], present[b, k], part)
            torch.testing.assert_close(moved[b, k], alone)
            for found, expected in zip(
                together, describe(one(alone), alone, present[b, k], part), strict=True
            ):
                torch.testing.assert_close(found[b, k], expected)


def test_the_oracle_projects():
    columns = np.random.default_rng(1).normal(size=(8, 3))
    assert np.abs(off(columns) @ columns).max() < 1e-12
    assert np.trace(off(columns)) == pytest.approx(5)
