"""Quadratic forms of all cells by few eigenvectors, against those of every cell by itself."""

import pytest
import torch
from oracles.arrays import complex_normal

from torchdt.filter.bp.rank_one import statistics, whiten
from torchdt.filter.proposal.cells import BULK, cell_statistics, slack
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.model.measurement import from_snapshots, mask_covariance

TONES, CELLS, SENSORS = 2, 300, 10


def make_dictionary(rng, *batch, dtype=torch.complex128) -> Dictionary:
    response = complex_normal(rng, *batch, TONES, CELLS, SENSORS).to(dtype)
    return Dictionary(torch.zeros(CELLS, 1), response, torch.linalg.vector_norm(response, dim=-1).square())


def make_whitener(rng, *batch, objects=2, dead=(), power=10.0, dtype=torch.complex128):
    columns = (power / SENSORS) ** 0.5 * complex_normal(rng, *batch, TONES, SENSORS, objects)
    noise = 0.1 + torch.rand(*batch, TONES, generator=rng, dtype=torch.float64)
    data = complex_normal(rng, *batch, TONES, 3, SENSORS) + 3 * columns.sum(-1)[..., None, :]
    data[..., list(dead)] = torch.nan
    measurement = from_snapshots(data.to(dtype))
    signal = (columns @ columns.mH).to(dtype)
    return whiten(measurement, mask_covariance(signal, noise.to(dtype.to_real()), measurement.present))


def assert_within_bounds(dictionary, whitener) -> None:
    """As far off as it says; the smallest number beside that, for sums of nothing."""
    found = cell_statistics(dictionary, whitener)
    s, q = statistics(whitener, dictionary.response)
    assert found.s.shape == found.q.shape == s.shape
    energy, off = dictionary.energy, slack(SENSORS, s.dtype)
    assert ((found.s - s).abs() <= found.s_error[..., None] * energy).all()
    least, most = torch.minimum(found.q, q), torch.maximum(found.q, q)
    assert (most <= (1 + off) ** 2 * least + found.q_error[..., None] * energy).all()


@pytest.mark.parametrize("dtype", [torch.complex64, torch.complex128])
@pytest.mark.parametrize("objects", [0, 1, 3, SENSORS])
@pytest.mark.parametrize("dead", [(), (2, 7)])
def test_noise_and_objects(objects, dead, dtype):
    rng = torch.Generator().manual_seed(objects)
    dictionary = make_dictionary(rng, dtype=dtype)
    for batch in ((), (3,), (2, 2)):
        assert_within_bounds(dictionary, make_whitener(rng, *batch, objects=objects, dead=dead, dtype=dtype))


def test_a_dictionary_for_each_sequence():
    rng = torch.Generator().manual_seed(0)
    assert_within_bounds(make_dictionary(rng, 3), make_whitener(rng, 3))


def test_in_white_noise_and_few_objects_nothing_is_lost():
    rng = torch.Generator().manual_seed(1)
    dictionary, whitener = make_dictionary(rng), make_whitener(rng, 4, power=1e4)
    found, (s, q) = cell_statistics(dictionary, whitener), statistics(whitener, dictionary.response)
    torch.testing.assert_close(found.s, s, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(found.q, q, rtol=1e-9, atol=1e-9)


def test_differences_within_the_bulk_are_all_that_is_left_out():
    """Objects so weak that no eigenvector is worth its while."""
    rng = torch.Generator().manual_seed(2)
    dictionary, whitener = make_dictionary(rng), make_whitener(rng, 4, power=1e-4)
    found, (s, _) = cell_statistics(dictionary, whitener), statistics(whitener, dictionary.response)
    assert_within_bounds(dictionary, whitener)
    assert 0 < (found.s / s - 1).abs().max() < BULK - 1


def test_a_sequence_does_not_depend_on_the_others():
    rng = torch.Generator().manual_seed(3)
    dictionary = make_dictionary(rng)
    each = [make_whitener(rng, 1, objects=n, power=100.0) for n in (0, 1, 5)]
    joined = type(each[0])(*(torch.cat(parts) for parts in zip(*each, strict=True)))
    together = cell_statistics(dictionary, joined)
    for b, alone in enumerate(each):
        for one, all_of_them in zip(cell_statistics(dictionary, alone), together, strict=True):
            torch.testing.assert_close(all_of_them[b], one[0], rtol=1e-12, atol=1e-12)


def test_it_is_a_constant_to_any_gradient():
    rng = torch.Generator().manual_seed(4)
    whitener = make_whitener(rng)
    whitener = whitener._replace(projection=whitener.projection.requires_grad_())
    assert not any(part.requires_grad for part in cell_statistics(make_dictionary(rng), whitener))
