"""BP, and the field of a waveguide, against plain NumPy."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from oracles import plain_bp
from oracles.plain_field import PlainField

from benchmarks.problem import random_problem
from benchmarks.update import plain_problem
from torchdt.field import Environment, HalfSpace, NormalModeField, solve_modes
from torchdt.filter.bp.update import update

LOUD, QUIET = 1.0, 0.35


def make_problem(seed, objects, loudness, missing=False, dtype=torch.float64):
    """In loud data all objects exist; in quiet data some, and of some one cannot be sure."""
    sizes = (objects, 50, 3, 8, 3, 6, 5)
    prior, response, noise, measurement = random_problem((), *sizes, dtype, "cpu", seed)
    generator = torch.Generator().manual_seed(seed)

    def uneven(even):
        return torch.randn(even.shape, generator=generator, dtype=torch.float64).to(dtype).log_softmax(-1)

    prior = prior._replace(
        log_weight=uneven(prior.log_weight), log_power_weight=uneven(prior.log_power_weight)
    )
    noise = noise._replace(log_weight=uneven(noise.log_weight))
    present = torch.ones_like(measurement.present)
    if missing:
        present[0, 2] = present[1, 5:] = 0
    factor = loudness * measurement.factor * present[..., None]
    return prior, response, noise, measurement._replace(factor=factor, present=present)


def check(found, expected, present, rtol, atol):
    """All of the beliefs; of the moments, what the others see."""
    for own, plain in (
        (found.objects.log_weight, expected.log_weight),
        (found.objects.log_power_weight, expected.log_power),
        (found.objects.log_odds, expected.log_odds),
        (found.noise.log_weight, expected.log_noise),
        (found.strength, expected.strength),
    ):
        assert_allclose(own, plain, rtol=rtol, atol=atol)
    for i, (plain, heard) in enumerate(zip(expected.moment, present.bool(), strict=True)):
        assert_allclose(found.moment[:, i][:, heard][..., heard], plain, rtol=rtol, atol=atol)


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("loudness", [LOUD, QUIET])
@pytest.mark.parametrize(("seed", "objects"), [(0, 3), (1, 4), (2, 5)])
def test_update_is_that_of_the_plain_formulation(seed, objects, loudness, missing):
    problem = make_problem(seed, objects, loudness, missing)
    plain = plain_bp.update(plain_problem(*problem), sweeps=3)
    check(update(*problem, sweeps=3), plain, problem[-1].present, 1e-8, 1e-8)


@pytest.mark.parametrize("sweeps", [1, 2])
def test_every_sweep_is_that_of_the_plain_formulation(sweeps):
    problem = make_problem(1, 4, QUIET)
    plain = plain_bp.update(plain_problem(*problem), sweeps)
    check(update(*problem, sweeps=sweeps), plain, problem[-1].present, 1e-8, 1e-8)


def test_empty_slots_are_left_alone():
    prior, *rest = make_problem(1, 4, QUIET)
    prior.log_odds[1] = -torch.inf
    plain = plain_bp.update(plain_problem(prior, *rest))
    assert plain.log_odds[1] == -np.inf
    check(update(prior, *rest), plain, rest[-1].present, 1e-8, 1e-8)


@pytest.mark.parametrize("loudness", [LOUD, QUIET])
def test_single_precision_is_close_to_the_plain_formulation(loudness):
    problem = make_problem(1, 4, loudness, dtype=torch.float32)
    plain = plain_bp.update(plain_problem(*problem))
    check(update(*problem), plain, problem[-1].present, 1e-4, 1e-3)


@pytest.mark.parametrize("missing", [False, True])
def test_both_plain_formulations_agree(missing):
    problem = plain_problem(*make_problem(1, 4, QUIET, missing))
    first = plain_bp.update(problem)
    second = plain_bp.update(problem, log_ratios=plain_bp.by_cholesky)
    for a, b in zip(first[:-1], second[:-1], strict=True):
        assert_allclose(a, b, rtol=1e-8, atol=1e-8)


def test_a_factorisation_serves_any_of_the_power_points():
    tone = plain_problem(*make_problem(0, 3, LOUD)).tones[0]
    arguments = (0.05 * np.eye(8), tone.response[0])
    every = plain_bp.by_rank_one(*arguments, tone.power[0], tone.factor, tone.J)
    some = plain_bp.by_cholesky(*arguments, tone.power[0, 2:4], tone.factor, tone.J)
    assert every.shape == (50, 6)
    assert_allclose(some, every[:, 2:4], rtol=1e-8, atol=1e-8)


def test_quiet_data_leave_room_for_doubt():
    existence = np.stack([update(*make_problem(s, 4, QUIET)).objects.log_odds.sigmoid() for s in range(3)])
    assert existence.min() < 0.1 < 0.9 < existence.max()
    assert ((existence > 0.05) & (existence < 0.95)).any()


@pytest.mark.parametrize("tilt", [0.0, 2.0])
def test_field_is_that_of_the_plain_mode_sum(tilt):
    environment = Environment(
        ((0.0, 1510.0), (40.0, 1490.0), (150.0, 1488.0)), (), HalfSpace(1800.0, 1.8, 0.5)
    )
    freqs, sensors = (49.0, 201.0, 388.0), np.linspace(60.0, 148.0, 9)
    low, high = torch.tensor([[500.0, 1.0], [5000.0, 149.0]], dtype=torch.float64)
    unit = torch.rand(40, 2, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    state = torch.lerp(low, high, unit)
    plain = PlainField([solve_modes(environment, f) for f in freqs], sensors, tilt)(state.numpy())
    own = NormalModeField(environment, freqs, sensors.tolist(), tilt, dtype=torch.float64)(state)
    assert_allclose(own, plain, rtol=0, atol=1e-9)
