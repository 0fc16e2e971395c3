import pytest
import torch
from oracles.arrays import complex_normal
from oracles.line_array import make_field, make_region

from torchdt.filter.bp.rank_one import peak_log_likelihood_ratio, statistics, whiten
from torchdt.filter.proposal.dictionary import bartlett_surface, build_dictionary, likelihood_surface
from torchdt.model.measurement import from_snapshots
from torchdt.model.region import Coordinate, Region

FIELD, REGION = make_field(), make_region()
DICTIONARY = build_dictionary(FIELD, REGION)


def snapshots(bearing: float, noise: float = 1e-3, steps: int = 3) -> torch.Tensor:
    rng = torch.Generator().manual_seed(1)
    a = FIELD(torch.tensor([bearing], dtype=torch.float64))
    amplitude = complex_normal(rng, steps, 2, 3, 1)
    return amplitude * a[:, None] + noise**0.5 * complex_normal(rng, steps, 2, 3, 8)


def test_dictionary_holds_the_field_at_the_cell_centres():
    torch.testing.assert_close(DICTIONARY.points, REGION.cell_centres())
    for c in (0, 33, 69):
        torch.testing.assert_close(DICTIONARY.response[:, c], FIELD(DICTIONARY.points[c]))


def test_dictionary_of_many_cells_is_whole():
    """More cells than are evaluated at once."""
    region = Region([Coordinate("bearing", "deg", -70, 70, 0.02, -1, 1, 1.0)], torch.float64)
    dictionary = build_dictionary(FIELD, region)
    assert dictionary.response.shape == (2, 7000, 8)
    torch.testing.assert_close(dictionary.response[:, 4097], FIELD(region.cell_centres()[4097]))


def test_nothing_is_found_where_no_object_can_be():
    """Cells outside the region of a bounded field have no response: no power, no likelihood."""
    region = Region(REGION.coordinates, torch.float64, inside=lambda state: state[..., 0] < 0)
    dictionary = build_dictionary(FIELD, region)
    left = region.is_birth_cell
    assert int(left.sum()) == 35
    assert torch.equal(dictionary.response[:, left], DICTIONARY.response[:, left])
    assert not dictionary.response[:, ~left].any()
    assert not dictionary.energy[:, ~left].any()
    measurement = from_snapshots(snapshots(30.0, noise=0.05))
    background = 0.05 * torch.eye(8, dtype=torch.complex128).expand(3, 2, 8, 8)
    surfaces = (
        bartlett_surface(dictionary, measurement),
        likelihood_surface(dictionary, whiten(measurement, background)),
    )
    for surface in surfaces:
        assert surface.isfinite().all()
        assert not surface[:, ~left].any()
        assert (surface[:, left].amax(-1) > 0).all()


def test_bartlett_equals_the_loop():
    z = snapshots(14.6, noise=0.05)
    surface = bartlett_surface(DICTIONARY, from_snapshots(z))
    for k in range(3):
        for c in (0, 20, 42):
            share = 0.0
            for i in range(2):
                a = DICTIONARY.response[i, c]
                matched = (a.conj() * z[k, i]).sum(-1).abs().square().sum()
                share += matched / (a.abs().square().sum() * z[k, i].abs().square().sum()) / 2
            torch.testing.assert_close(surface[k, c], share)
    assert ((surface >= 0) & (surface <= 1)).all()


def test_bartlett_is_one_at_a_source_without_noise():
    surface = bartlett_surface(DICTIONARY, from_snapshots(snapshots(15.0, noise=0.0)))
    assert surface.argmax(-1).eq(42).all()  # centre of cell 42: -70 + 2 * 42.5
    torch.testing.assert_close(surface[:, 42], torch.ones(3, dtype=torch.float64))


def test_bartlett_leaves_out_missing_sensors_and_tones():
    z = snapshots(15.0, noise=0.0)
    z[..., 3] = torch.nan
    z[:, 1] = torch.nan
    z[2] = torch.nan
    surface = bartlett_surface(DICTIONARY, from_snapshots(z))
    torch.testing.assert_close(surface[:2, 42], torch.ones(2, dtype=torch.float64))
    assert surface[2].eq(0).all()


@pytest.mark.parametrize("batch", [(), (3,), (3, 1)])
def test_likelihood_surface_is_the_peak_ratio_of_every_cell(batch):
    z = snapshots(15.0).reshape(3, 2, 3, 8)
    measurement = from_snapshots(z.reshape(*batch, 2, 3, 8) if batch else z[0])
    background = 1e-3 * torch.eye(8, dtype=torch.complex128).expand(*batch, 2, -1, -1)
    whitener = whiten(measurement, background)
    surface = likelihood_surface(DICTIONARY, whitener)
    s, q = statistics(whitener, DICTIONARY.response)
    peak, _ = peak_log_likelihood_ratio(whitener.num_snapshots[..., None], s, q)
    torch.testing.assert_close(surface, peak.sum(-2))
    assert surface.shape == (*batch, 70)
    assert surface.argmax(-1).eq(42).all()
