import torch
from oracles.tart import SIZE, scene

from recordings.tart_standing import standing_covariance, without_standing


def crosstalk(scale):
    """Hermitian, off the diagonal."""
    stream = torch.Generator().manual_seed(1)
    matrix = torch.randn(SIZE, SIZE, generator=stream, dtype=torch.complex128).triu(1)
    return scale * (matrix + matrix.mH)


def test_a_sky_is_kept_whole():
    field, region, covariance = scene(0)
    standing = standing_covariance(covariance, field, region)
    assert standing.abs().max() < 1e-6
    torch.testing.assert_close(without_standing(covariance, standing), covariance, atol=1e-6, rtol=0)


def test_most_of_what_is_no_sky_is_taken_out():
    added = crosstalk(0.05)
    field, region, covariance = scene(added)
    standing = standing_covariance(covariance, field, region)
    torch.testing.assert_close(standing, standing.mH)
    assert standing.diagonal().abs().max() == 0
    assert (standing - added).norm() < 0.8 * added.norm()


def test_less_a_standing_part_it_is_still_a_covariance():
    _, _, covariance = scene(0)
    cleaned = without_standing(covariance, crosstalk(0.3))
    assert torch.linalg.eigvalsh(cleaned).min() > -1e-12
    torch.testing.assert_close(cleaned.diagonal(dim1=-2, dim2=-1).real, torch.ones(4, SIZE).double())
