import torch

from torchdt.data.tart_standing import standing_covariance, without_standing
from torchdt.field.plane_wave import PlaneWaveField
from torchdt.model.region import Coordinate, Region

SIZE = 10


def scene(standing):
    """Field, region, and covariances `(4, M, M)` of two sources at centres of cells, one of which moves."""
    stream = torch.Generator().manual_seed(0)
    place = torch.rand(SIZE, 3, generator=stream, dtype=torch.float64) * torch.tensor([1.0, 1.0, 0.0])
    field = PlaneWaveField([1.5e9], place.tolist(), 3e8, "direction_cosines", dtype=torch.float64)
    coordinates = [Coordinate(name, "cos", -1, 1, 0.1, -1, 1, 1.0) for name in ("east", "north")]
    region = Region(coordinates, torch.float64).within(field)
    still, moving = torch.tensor([0.35, 0.15]), torch.tensor([[-0.55, 0.05 + 0.1 * k] for k in range(4)])
    position = torch.stack([still.expand(4, 2), moving], 1).double()
    wave = SIZE**0.5 * field(position)[..., 0, :].mT
    sky = wave @ (torch.tensor([0.3, 0.2], dtype=torch.float64)[:, None] * wave.mH)
    return field, region, sky + 0.5 * torch.eye(SIZE) + standing


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
