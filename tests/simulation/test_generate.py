"""Draws against the distributions they are to have; exact tests, false alarm of 1e-6 each unless stated."""

import math
from dataclasses import replace

import pytest
import torch
from oracles.line_array import BEARING, FREQS, POSITIONS, make_field, make_region
from oracles.scripts import track_settings
from scipy.special import digamma, polygamma
from scipy.stats import binom, chi2, gamma, kstest, poisson, uniform

from torchdt.app.build import simulate
from torchdt.app.settings import TrackSettings
from torchdt.model.region import Coordinate, Region
from torchdt.simulation.generate import draw_chain, draw_population, generate_snapshots
from torchdt.simulation.settings import CoordinateSettings, PopulationSettings, ScenarioSettings

ALARM = 1e-6
FIELD, NARROW = make_field(), make_region()
# So wide and slow that hardly anything ever leaves it.
WIDE = Region(
    [
        Coordinate("range", "m", 0.0, 1e9, 1e8, -4.0, 2.0, 1e-2),
        Coordinate("depth", "m", -1e9, 1e9, 1e8, 0.5, 1.0, 1e-5),
    ],
    torch.float64,
)
STEP_S = 2.0


def rng(seed: int = 1) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def draw(settings: PopulationSettings, num_steps: int = 400, region: Region = WIDE, seed: int = 1):
    return draw_population(region, settings, num_steps, STEP_S, 3, rng(seed))


def there(population) -> torch.Tensor:
    """Presence `(K, L)`; power and state must agree on it."""
    present = ~population.power.isnan().any(-1)
    assert torch.equal(population.state.isnan(), ~present[..., None].expand_as(population.state))
    assert torch.equal(population.power.isnan(), ~present[..., None].expand_as(population.power))
    return present


def first_values(values: torch.Tensor, present: torch.Tensor) -> torch.Tensor:
    birth = present.int().argmax(0)
    return values[birth, torch.arange(values.shape[1])]


def within(statistic: float, distribution) -> None:
    """Two-sided test at `ALARM`."""
    assert distribution.ppf(ALARM / 2) <= statistic <= distribution.ppf(1 - ALARM / 2)


def follows(values: torch.Tensor, distribution) -> None:
    """Kolmogorov and Smirnov's test at `ALARM`."""
    assert kstest(values.flatten().numpy(), distribution.cdf).pvalue > ALARM


def log_gain(shape: float) -> tuple[float, float, float]:
    """Mean, variance and fourth cumulant of the logarithm of a Gamma variable of mean one."""
    cumulants = (polygamma(order, shape) for order in (1, 3))
    return float(digamma(shape)) - math.log(shape), *map(float, cumulants)


def has_moments(values: torch.Tensor, mean: float, variance: float, fourth: float) -> None:
    """Sample mean and variance of thousands, each within five standard deviations: false alarm below 1e-5."""
    centred, number = values - mean, values.numel()
    assert centred.mean().abs() < 5 * (variance / number) ** 0.5
    assert (centred.square().mean() - variance).abs() < 5 * ((fourth + 2 * variance**2) / number) ** 0.5


def transitions(values: torch.Tensor) -> torch.Tensor:
    """Ratios of neighbouring steps in which a source is there."""
    ratio = values[1:] / values[:-1]
    return ratio[~ratio.isnan()]


def test_births_are_a_poisson_process():
    present = there(draw(PopulationSettings(birth_mean=1.5, survival=0.0), 800))
    number = present.int().argmax(0).bincount(minlength=800)
    within(number.sum().item(), poisson(1.5 * 800))
    within(number.eq(0).sum().item(), binom(800, math.exp(-1.5)))
    within(number.eq(1).sum().item(), binom(800, 1.5 * math.exp(-1.5)))
    assert present.any(0).all()


def test_sources_start_uniformly_in_the_region():
    population = draw(PopulationSettings(birth_mean=5.0, survival=0.3, power_db=[-4.0, 2.0]))
    present = there(population)
    start = first_values(population.state, present)
    low, high = [0.0, -1e9, -4.0, 0.5], [1e9, 1e9, 2.0, 1.0]
    for entry in range(4):
        follows(start[:, entry], uniform(low[entry], high[entry] - low[entry]))
    decibel = 10 * first_values(population.power, present).log10()
    for tone in range(3):
        follows(decibel[:, tone], uniform(-4.0, 6.0))
    # No two entries go together: a correlation of N pairs is about N(0, 1 / N); the largest of 21 at 5.6
    # standard deviations is a false alarm of 1e-6.
    entries = torch.cat([start, decibel], 1)
    off_diagonal = torch.corrcoef(entries.T) - torch.eye(7)
    assert off_diagonal.abs().max() < 5.6 / len(entries) ** 0.5


def test_powers_that_start_uniformly():
    levels = {"power_db": [-10.0, 3.0], "power_density": "uniform"}
    population = draw(PopulationSettings(birth_mean=5.0, survival=0.3, **levels))
    power = first_values(population.power, there(population))
    follows(power, uniform(0.1, 10**0.3 - 0.1))


def test_nothing_is_where_no_object_can_be():
    """Births in half of a box of two cells: as many as in a whole box, all in that half."""
    coordinate = Coordinate("x", "m", -1.0, 1.0, 1.0, -1e-3, 1e-3, 1e-9)
    half = Region([coordinate], torch.float64, inside=lambda state: state[..., 0] > 0)
    population = draw(PopulationSettings(birth_mean=0.5, survival=0.9), region=half)
    present = there(population)
    assert (population.state[present][:, 0] > 0).all()
    within(
        int((present.int().diff(dim=0, prepend=torch.zeros_like(present[:1]).int()) == 1).sum()), poisson(200)
    )


def test_lifetimes_are_geometric():
    """Of the sources born early enough, a share p_s^m is there m steps after birth."""
    survival, num_steps = 0.96, 400
    present = there(draw(PopulationSettings(birth_mean=4.0, survival=survival), num_steps))
    birth = present.int().argmax(0)
    last = birth + present.sum(0) - 1
    # Nobody comes back.
    steps = torch.arange(num_steps)[:, None]
    assert torch.equal(present, (steps >= birth) & (steps <= last))
    for age in (1, 2, 10, 30, 80):
        early = birth + age < num_steps
        within((last >= birth + age)[early].sum().item(), binom(int(early.sum()), survival**age))


@pytest.mark.parametrize(("survival", "lifetime"), [(0.0, 1), (1.0, 20)])
def test_certain_survival_and_certain_death(survival, lifetime):
    present = there(draw(PopulationSettings(birth_mean=3.0, survival=survival), 20))
    birth = present.int().argmax(0)
    assert present.shape[1] > 5
    assert torch.equal(present.sum(0), (20 - birth).clamp(max=lifetime))


def test_driving_noise():
    """The rate gains T q in each step, the position T times the old rate and T^2 q / 2."""
    state = draw(PopulationSettings(birth_mean=1.0, survival=0.95)).state
    position, rate = state.chunk(2, dim=-1)
    q = rate.diff(dim=0) / STEP_S
    moved = position[:-1] + STEP_S * rate[:-1] + STEP_S**2 / 2 * q
    torch.testing.assert_close(
        moved, torch.where(q.isnan(), torch.nan, position[1:]), rtol=0, atol=1e-6, equal_nan=True
    )
    for values, variance in zip(q.unbind(-1), (1e-2, 1e-5), strict=True):
        values = values[~values.isnan()]
        within((values.square().sum() / variance).item(), chi2(len(values)))
        assert values.mean().abs() < 5 * (variance / len(values)) ** 0.5


def test_a_source_dies_where_it_leaves():
    """Without driving noise the step of leaving is known, and coming back impossible."""
    bearing = Coordinate("bearing", "deg", -10.0, 10.0, 2.0, -1.0, 1.0, 1e-30)
    region = Region([bearing], torch.float64)
    population = draw(PopulationSettings(birth_mean=1.0, survival=1.0), 60, region)
    present = there(population)
    position, rate = first_values(population.state, present).unbind(-1)
    expected = ((10.0 * rate.sign() - position) / (rate * STEP_S)).floor().long() + 1
    birth = present.int().argmax(0)
    assert torch.equal(present.sum(0), torch.minimum(expected, 60 - birth))
    assert (expected < 60 - birth).sum() > 10
    assert population.state[..., 0][present].abs().max() <= 10.0


def test_at_most_so_many_at_once():
    """Those who find the region full are left out, and all others are as they would have been."""
    settings = {"birth_mean": 0.5, "survival": 0.9}
    free, capped = (draw(PopulationSettings(**settings, max_objects=most), 200) for most in (None, 3))
    present = there(free)
    number = torch.zeros(200, dtype=torch.long)
    kept = []
    for source, birth in enumerate(present.int().argmax(0)):
        if number[birth] < 3:
            kept.append(source)
            number += present[:, source]
    torch.testing.assert_close(capped.state, free.state[:, kept], rtol=0, atol=0, equal_nan=True)
    torch.testing.assert_close(capped.power, free.power[:, kept], rtol=0, atol=0, equal_nan=True)
    assert there(capped).sum(1).max() == 3 < present.sum(1).max()


@pytest.mark.parametrize("shape", [0.7, 20.0, 1e4])
def test_powers_are_gamma_chains(shape):
    power = draw(PopulationSettings(birth_mean=1.0, survival=0.95, power_shape=shape), 300).power
    gains = transitions(power)
    follows(gains, gamma(shape, scale=1 / shape))
    # The sum of n gains is Gamma distributed with shape n c.
    within(gains.sum().item(), gamma(len(gains) * shape, scale=1 / shape))
    has_moments(gains.log(), *log_gain(shape))


def test_tones_wander_apart():
    """Gains of different tones are not correlated; five standard deviations, a false alarm below 1e-5."""
    power = draw(PopulationSettings(birth_mean=1.0, survival=0.95, power_shape=50.0), 300).power
    gains = transitions(power).reshape(-1, 3)
    correlation = torch.corrcoef(gains.T) - torch.eye(3)
    assert correlation.abs().max() < 5 / len(gains) ** 0.5


def test_chains_rest_where_there_is_no_transition():
    start = torch.tensor([2.0, 3.0], dtype=torch.float64)
    moving = torch.tensor([[False, False], [False, True], [True, True], [False, True]])
    values = draw_chain(start, moving, 20.0, rng())
    assert torch.equal(values[0], start)
    assert torch.equal(values.diff(dim=0) != 0, moving[1:])


def scenario(**settings) -> ScenarioSettings:
    settings = {"num_steps": 60, "num_snapshots": 4, "snr_db": 10.0} | settings
    return ScenarioSettings(coordinates=[CoordinateSettings(**BEARING)], **settings)


def generate(population: PopulationSettings, seed: int = 1, **settings):
    return generate_snapshots(FIELD, NARROW, scenario(**settings), population, rng(seed))


def test_noise_starts_at_the_signal_to_noise_ratio():
    """The first step is before the first transition, however wild it is."""
    wild = PopulationSettings(birth_mean=0.0, noise_shape=0.1)
    snapshots, _ = generate(wild, num_steps=1, num_snapshots=100)
    for energy in snapshots.abs().square().sum((0, 2, 3)):
        within(energy.item(), gamma(100 * 8, scale=0.1 / 8))


def test_noise_is_a_gamma_chain():
    """Energies per step and tone; given eta they are eta times a Gamma variable of shape J M."""
    quiet = PopulationSettings(birth_mean=0.0, noise_shape=20.0)
    snapshots, truth = generate(quiet, num_steps=2000, num_snapshots=50)
    assert (snapshots.shape, snapshots.dtype) == ((2000, 2, 50, 8), torch.complex128)
    assert (truth.shape, truth.dtype) == ((2000, 0, 1), torch.float64)
    energy = snapshots.abs().square().sum((-2, -1))
    # The ratio of two energies is eta' / eta times that of two such variables. Neighbouring ratios share one
    # of them, so only every other counts.
    mean, variance, fourth = log_gain(20.0)
    _, share, share_fourth = log_gain(50.0 * 8)
    has_moments((energy[1::2] / energy[::2]).log(), mean, variance + 2 * share, fourth + 2 * share_fourth)


def test_snapshots_have_the_covariance_of_the_model():
    """Whitened by `sum_l gamma_l a_l a_l^H + eta I` they are standard, in total and per tone and sensor."""
    settings = PopulationSettings(
        birth_mean=0.2, survival=0.97, power_shape=50.0, noise_shape=1e16, power_db=[-3.0, 3.0]
    )
    snapshots, truth = generate(settings, num_steps=200)
    sources = draw_population(NARROW, settings, 200, 1.0, 2, rng())
    torch.testing.assert_close(truth, sources.state[..., :1], rtol=0, atol=0, equal_nan=True)
    assert there(sources).sum(1).max() >= 3
    response = FIELD(sources.state.nan_to_num()).mT  # (K, L, M, I)
    power = sources.power.nan_to_num().to(response)
    covariance = torch.einsum("kli,klmi,klni->kimn", power, response, response.conj())
    covariance = covariance + 0.1 / 8 * torch.eye(8)
    factor = torch.linalg.cholesky(covariance)
    white = torch.linalg.solve_triangular(factor, snapshots.mT, upper=False)  # (K, I, M, J)
    energy = 2 * white.abs().square()
    within(energy.sum().item(), chi2(2 * white.numel()))
    for part in energy.sum((0, 3)).flatten():
        within(part.item(), chi2(2 * 200 * 4))
    # Steps and snapshots are independent; the mean of N products is about CN(0, 1 / N), and
    # its magnitude at four standard deviations a false alarm of exp(-16).
    for one, other in ((white[1:], white[:-1]), (white[..., 1:], white[..., :-1])):
        assert (one * other.conj()).mean().abs() < 4 / one.numel() ** 0.5


def test_sources_and_tones_have_amplitudes_of_their_own():
    """Without noise two sources come apart; the mean of N products is tested as above."""
    settings = PopulationSettings(birth_mean=0.3, survival=0.97, max_objects=2)
    snapshots, truth = generate(settings, snr_db=400.0, num_steps=200)
    power = draw_population(NARROW, settings, 200, 1.0, 2, rng()).power
    present = ~truth.isnan().any(-1)
    pairs = present.sum(1) == 2
    response = FIELD(truth[pairs][present[pairs]].reshape(-1, 2, 1))  # (pairs, 2, I, M)
    amplitude = torch.linalg.pinv(response.permute(0, 2, 3, 1)) @ snapshots[pairs].mT  # (pairs, I, 2, J)
    rho = amplitude / power[pairs][present[pairs]].reshape(-1, 2, 2).mT.sqrt()[..., None]
    within(2 * rho.abs().square().sum().item(), chi2(2 * rho.numel()))
    assert len(rho) > 50
    for one, other in (rho.unbind(2), rho.unbind(1)):
        assert (one * other.conj()).mean().abs() < 4 / one.numel() ** 0.5


def test_amplitudes_are_those_of_the_scenario():
    settings = PopulationSettings(birth_mean=0.3, survival=0.97, max_objects=1)
    snapshots, truth = generate(settings, snr_db=400.0, amplitudes="constant_modulus")
    present = ~truth.isnan().any(-1).all(-1)
    power = draw_population(NARROW, settings, 60, 1.0, 2, rng()).power.nansum(1)
    energy = snapshots.abs().square().sum(-1)
    torch.testing.assert_close(energy[present], power[present][..., None].expand(-1, -1, 4))
    assert energy[~present].max() < 1e-30
    assert 0 < present.sum() < 60


def test_the_seed_decides():
    settings = PopulationSettings(birth_mean=0.3, power_shape=50.0, noise_shape=20.0)
    (one, first), (again, second), (other, _) = (generate(settings, seed) for seed in (1, 1, 2))
    assert torch.equal(one, again)
    torch.testing.assert_close(first, second, rtol=0, atol=0, equal_nan=True)
    assert not torch.isclose(one, other).any()


def test_a_sequence_of_a_batch_is_the_sequence_alone():
    field = {"_target_": "torchdt.field.LineArrayField", "freqs": FREQS, "positions": POSITIONS}
    population = PopulationSettings(birth_mean=0.08, noise_shape=20.0)
    settings = {"scenario": scenario(population=population, num_steps=20), "field": field}
    batch = simulate(TrackSettings(**settings, seed=3, runs=6))
    numbers = batch.truth_mask.any(1).sum(-1)
    assert numbers.min() == 0 < 1 < numbers.max() == batch.truth.shape[2]
    for b, number in enumerate(numbers):
        alone = simulate(TrackSettings(**settings, seed=3 + b))
        assert torch.equal(alone.snapshots[0], batch.snapshots[b])
        assert alone.truth.shape[2] == number
        padded = batch.truth[b, :, :number]
        torch.testing.assert_close(alone.truth[0], padded, rtol=0, atol=0, equal_nan=True)
        assert batch.truth[b, :, number:].isnan().all()


def test_nothing_leaves_a_region_that_goes_round():
    """Sources that go round once in twelve steps, and would otherwise be gone after as many."""
    azimuth = Coordinate("azimuth", "deg", -180, 180, 5, 14, 16, 1e-6)
    settings = PopulationSettings(birth_mean=0.2, survival=1.0)
    for period, stays in ((360.0, True), (None, False)):
        region = Region([replace(azimuth, period=period)], torch.float64)
        present = there(draw(settings, 40, region))
        assert bool(present[-1].all()) is stays


def test_the_truth_of_a_simulation_is_within_one_turn():
    chosen = track_settings("scenario=all_round", "scenario.num_steps=12", small=False)
    truth = simulate(chosen).truth[0, :, 0, 0]
    assert truth[:11].tolist() == pytest.approx([*range(90, 180, 9), -180])
