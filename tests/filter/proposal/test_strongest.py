"""The most likely cell, against the whole surface."""

import pytest
import torch
from oracles.arrays import complex_normal

from torchdt.filter.bp.rank_one import Whitener, whiten
from torchdt.filter.proposal.cells import BULK
from torchdt.filter.proposal.dictionary import Dictionary, likelihood_surface
from torchdt.filter.proposal.strongest import strongest_cell
from torchdt.model.measurement import from_snapshots, mask_covariance

TONES, CELLS, SENSORS = 3, 400, 12


@pytest.fixture
def rng():
    return torch.Generator().manual_seed(0)


def anywhere(dictionary, whitener):
    """Among all sequences."""
    return strongest_cell(dictionary, whitener, whitener.num_snapshots[..., 0].isfinite())


def make_dictionary(rng, *batch, dtype=torch.complex128):
    response = complex_normal(rng, *batch, TONES, CELLS, SENSORS)
    response = (response * (0.5 + complex_normal(rng, TONES, CELLS, 1).abs())).to(dtype)
    return Dictionary(torch.zeros(CELLS, 2), response, torch.linalg.vector_norm(response, dim=-1).square())


def make_whitener(rng, *batch, objects, power, dtype=torch.complex128, heard=None, dead=()):
    """Data in noise and objects of the background; one response more is heard where `heard` is given."""
    columns = (power / SENSORS) ** 0.5 * complex_normal(rng, *batch, TONES, SENSORS, objects)
    background = columns @ columns.mH + 0.1 * torch.eye(SENSORS, dtype=columns.dtype)
    root = torch.linalg.cholesky(background)
    data = (root @ complex_normal(rng, *batch, TONES, SENSORS, 3)).mT
    if heard is not None:
        data = data + heard * complex_normal(rng, *batch, TONES, 3, 1)
    data[..., list(dead)] = torch.nan
    return whiten(from_snapshots(data.to(dtype)), background.to(dtype))


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("power", [0.01, 1.0, 1e4])
@pytest.mark.parametrize("objects", [1, 3, SENSORS])
def test_is_the_largest_value_of_the_surface(rng, objects, power, dtype):
    dictionary = make_dictionary(rng, dtype=dtype)
    for batch in ((), (4,), (2, 3)):
        whitener = make_whitener(rng, *batch, objects=objects, power=power, dtype=dtype)
        surface = likelihood_surface(dictionary, whitener)
        score, cell = anywhere(dictionary, whitener)
        torch.testing.assert_close(score, surface.amax(-1), rtol=1e-4, atol=1e-4)
        torch.testing.assert_close(surface.gather(-1, cell[..., None])[..., 0], score, rtol=1e-4, atol=1e-4)


def test_the_most_promising_cell_need_not_be_the_strongest(rng):
    """Where noise differs from sensor to sensor, bounds are not tight."""
    dictionary = make_dictionary(rng)
    level = 1 + 0.8 * (BULK - 1) * torch.rand(50, TONES, SENSORS, generator=rng, dtype=torch.float64)
    background = torch.diag_embed(level.to(torch.complex128))
    data = (level.sqrt()[..., None] * complex_normal(rng, 50, TONES, SENSORS, 3)).mT
    whitener = whiten(from_snapshots(data), background)
    score, cell = anywhere(dictionary, whitener)
    expected = likelihood_surface(dictionary, whitener).max(-1)
    assert torch.equal(cell, expected.indices)
    torch.testing.assert_close(score, expected.values)


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
def test_finds_what_is_heard(rng, dtype):
    dictionary = make_dictionary(rng, dtype=dtype)
    heard = dictionary.response[:, 123].to(torch.complex128)[:, None]
    whitener = make_whitener(rng, 5, objects=2, power=1e3, dtype=dtype, heard=30 * heard)
    assert anywhere(dictionary, whitener)[1].eq(123).all()


def test_missing_sensors_and_tones(rng):
    dictionary = make_dictionary(rng)
    whitener = make_whitener(rng, 4, objects=2, power=1e3, dead=(3, 7))
    score, cell = anywhere(dictionary, whitener)
    expected = likelihood_surface(dictionary, whitener).max(-1)
    torch.testing.assert_close(score, expected.values)
    assert torch.equal(cell, expected.indices)


def test_one_dictionary_for_each_sequence(rng):
    dictionary = make_dictionary(rng, 4)
    whitener = make_whitener(rng, 4, objects=2, power=1e3)
    score, cell = anywhere(dictionary, whitener)
    expected = likelihood_surface(dictionary, whitener).max(-1)
    torch.testing.assert_close(score, expected.values)
    assert torch.equal(cell, expected.indices)


def test_the_blocks_do_not_matter(rng, monkeypatch):
    dictionary, whitener = make_dictionary(rng), make_whitener(rng, 2, objects=2, power=1e3)
    whole = anywhere(dictionary, whitener)
    monkeypatch.setattr("torchdt.filter.proposal.cells.BLOCK", 5000)
    for found, expected in zip(anywhere(dictionary, whitener), whole, strict=True):
        torch.testing.assert_close(found, expected)


def test_a_cell_whose_sensor_is_noisier_than_the_bulk_says():
    """It is the strongest by a little; by the mean of the bulk cells of other sensors pass for stronger."""
    sensors, copies = 4, 40
    inverse = torch.tensor([1.0, 1.0, 1.0, 1 - 0.9 * (BULK - 1)], dtype=torch.float64)
    response = torch.eye(sensors, dtype=torch.complex128).repeat_interleave(copies, 0)[None]
    dictionary = Dictionary(
        torch.zeros(len(response[0]), 2), response, torch.ones(1, len(response[0])).double()
    )
    energy = 5 / inverse
    energy[-1] *= 1.0001
    data = torch.diag_embed(energy.sqrt()).to(torch.complex128)[None]
    whitener = whiten(
        from_snapshots(data)._replace(num_snapshots=torch.ones(1).double()),
        torch.diag(1 / inverse)[None] + 0j,
    )
    _, cell = strongest_cell(dictionary, whitener, torch.tensor(True))
    assert cell >= (sensors - 1) * copies


@pytest.mark.parametrize("objects", [2, SENSORS])
def test_favour_is_added_to_the_surface(rng, objects):
    """Also where it is that of no other cell, or forbids most of them."""
    dictionary, whitener = make_dictionary(rng), make_whitener(rng, 4, objects=objects, power=1e3)
    surface = likelihood_surface(dictionary, whitener)
    favour = -5 * torch.rand(4, CELLS, generator=rng, dtype=torch.float64)
    favour[:2, 10:] = -torch.inf
    favour[0] = -torch.inf
    favour[0, 7] = -20.0
    among = torch.ones(4, dtype=torch.bool)
    score, cell = strongest_cell(dictionary, whitener, among, favour)
    expected = (surface + favour).max(-1)
    torch.testing.assert_close(score, expected.values)
    assert torch.equal(cell, expected.indices)
    assert (cell != surface.argmax(-1)).any()


def test_only_some_sequences_are_looked_at(rng):
    whitener, among = make_whitener(rng, 4, objects=2, power=1e3), torch.tensor([False, True, False, True])
    for dictionary in (make_dictionary(rng), make_dictionary(rng, 4)):
        score, cell = strongest_cell(dictionary, whitener, among)
        expected = likelihood_surface(dictionary, whitener).max(-1)
        torch.testing.assert_close(score[among], expected.values[among])
        assert torch.equal(cell[among], expected.indices[among])
        assert score[~among].isneginf().all()
        assert strongest_cell(dictionary, whitener, among & ~among)[0].isneginf().all()


def make_waves(*spacings, dtype):
    """Plane waves of unit norm on a line, one tone for each spacing of the sensors in wavelengths.

    Neighbouring cells are alike where it is small, and nothing is born in the first three.
    """
    sine = torch.linspace(-1, 1, 61, dtype=torch.float64)
    cycles = torch.tensor(spacings)[:, None, None] * sine[:, None] * torch.arange(SENSORS)
    response = torch.polar(torch.full_like(cycles, SENSORS**-0.5), 2 * torch.pi * cycles).to(dtype)
    response[:, :3] = 0.0
    return Dictionary(sine[:, None], response, torch.linalg.vector_norm(response, dim=-1).square())


def make_step(rng, dictionary, condition, num):
    """Up to three objects known in noise of variance one, and one more heard in every other sequence.

    Two sensors are dead in one in three sequences, the first tone in one in four, and the last has no data.
    """
    response = dictionary.response.to(torch.complex128)
    tones, cells = response.shape[-3:-1]
    place = torch.randint(3, cells, (num, 1, 4, 1), generator=rng)
    steering = response.expand(num, *response.shape[-3:]).take_along_dim(place, -2)
    known = torch.rand(num, 1, 3, generator=rng, dtype=torch.float64) < 0.7
    power = (condition - 1) * torch.tensor([1.0, 0.3, 0.01], dtype=torch.float64) * known
    amplitude = complex_normal(rng, num, tones, 3, 4)
    amplitude[..., :3] *= power.sqrt()[..., None, :]
    amplitude[..., 3] *= 5.0 * (torch.arange(num) % 2)[:, None, None]
    data = amplitude @ steering + complex_normal(rng, num, tones, 3, SENSORS)
    data[::3, ..., [3, 7]] = torch.nan
    data[::4, 0] = torch.nan
    data[-1] = torch.nan
    known_steering = steering[..., :3, :]
    signal = (known_steering.mT * power[..., None, :]) @ known_steering.conj()
    measurement = from_snapshots(data)
    noise = torch.ones(num, tones, dtype=torch.float64)
    whitener = whiten(measurement, mask_covariance(signal, noise, measurement.present))
    real = dictionary.energy.dtype
    return Whitener(whitener.projection.to(dictionary.response.dtype), whitener.num_snapshots.to(real))


def assert_is_that_of_testing_all(dictionary, whitener, condition):
    surface = likelihood_surface(dictionary, whitener)
    score, cell = anywhere(dictionary, whitener)
    # Where s nearly cancels, the order of a sum changes it by the root of the condition.
    accuracy = 20 * torch.finfo(score.dtype).eps * condition**0.5
    torch.testing.assert_close(score, surface.amax(-1), rtol=accuracy, atol=accuracy)
    torch.testing.assert_close(
        surface.gather(-1, cell[..., None])[..., 0], score, rtol=accuracy, atol=accuracy
    )


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("condition", [1.0, 1e3, 1e6, 1e9])
def test_rounding_hides_no_cell(rng, condition, dtype, monkeypatch):
    monkeypatch.setattr(
        "torchdt.filter.proposal.strongest.PROMISING", 1
    )  # more of them would hide a wrong bound
    one = make_waves(0.02, 0.2, 0.5, dtype=dtype)
    assert_is_that_of_testing_all(one, make_step(rng, one, condition, 24), condition)
    several = [make_waves(*(0.6 * torch.rand(3, generator=rng)).tolist(), dtype=dtype) for _ in range(24)]
    each = Dictionary(one.points, *(torch.stack([d[i] for d in several]) for i in (1, 2)))
    assert_is_that_of_testing_all(each, make_step(rng, each, condition, 24), condition)


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("condition", [1.0, 1e5, 1e9])
def test_flat_surface(rng, condition, dtype):
    """All cells alike, as of an array much smaller than the wavelength."""
    dictionary = make_waves(1e-7, 1e-7, dtype=dtype)
    assert_is_that_of_testing_all(dictionary, make_step(rng, dictionary, condition, 12), condition)
