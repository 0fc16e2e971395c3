"""The most likely cell, against the whole surface."""

import pytest
import torch
from oracles.arrays import complex_normal

from torchdt.bp.rank_one import whiten
from torchdt.detect.dictionary import Dictionary, likelihood_surface
from torchdt.detect.strongest import BULK, strongest_cell
from torchdt.model.measurement import from_snapshots

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
    monkeypatch.setattr("torchdt.detect.strongest.BLOCK", 5000)
    for found, expected in zip(anywhere(dictionary, whitener), whole, strict=True):
        torch.testing.assert_close(found, expected)


def test_only_some_sequences_are_looked_at(rng):
    whitener, among = make_whitener(rng, 4, objects=2, power=1e3), torch.tensor([False, True, False, True])
    for dictionary in (make_dictionary(rng), make_dictionary(rng, 4)):
        score, cell = strongest_cell(dictionary, whitener, among)
        expected = likelihood_surface(dictionary, whitener).max(-1)
        torch.testing.assert_close(score[among], expected.values[among])
        assert torch.equal(cell[among], expected.indices[among])
        assert score[~among].isneginf().all()
        assert strongest_cell(dictionary, whitener, among & ~among)[0].isneginf().all()
