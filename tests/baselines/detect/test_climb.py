import pytest
import torch
from torch import Tensor

from torchdt.baselines.detect.climb import climb
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
REGION = Region(
    [Coordinate("x", "m", 0, 100, 5, -1, 1, 1.0), Coordinate("y", "m", -1, 1, 0.1, -1, 1, 1.0)], F64
)
RESOLUTION = REGION.cell / 64


def hill(peak: Tensor, correlation: float = 0.0):
    """A concave score with its maximum of 0 at `peak` (*batch, d); 2 coordinates may be correlated."""

    def score(x: Tensor) -> Tensor:
        cells = (x - peak[..., None, :]) / REGION.cell[: x.shape[-1]]
        return -cells.square().sum(-1) + 2 * correlation * cells[..., 0] * cells[..., -1]

    return score


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_the_peak_is_found_to_its_resolution(correlation):
    centre = torch.tensor([52.5, 0.25], dtype=F64)
    offset = torch.rand(40, 2, generator=torch.Generator().manual_seed(1), dtype=F64) * 1.8 - 0.9
    peak = centre + offset * REGION.cell
    found = climb(hill(peak, correlation), centre.expand(40, 2), REGION)
    assert ((found - peak).abs() <= RESOLUTION).all()


def test_one_coordinate():
    region = Region(REGION.coordinates[:1], F64)
    found = climb(hill(torch.tensor([31.37], dtype=F64)), torch.tensor([32.5], dtype=F64), region)
    assert found.shape == (1,)
    assert found.item() == pytest.approx(31.37, abs=5 / 64)


def test_it_stays_within_a_cell_and_the_region():
    centre = torch.tensor([[52.5, 0.25], [97.5, -0.95]], dtype=F64)
    far = torch.tensor([[90.0, -0.9], [400.0, -7.0]], dtype=F64)
    expected = torch.tensor([[57.5, 0.15], [100.0, -1.0]], dtype=F64)
    torch.testing.assert_close(climb(hill(far), centre, REGION), expected)


def test_it_stays_where_nothing_is_gained():
    centre = torch.tensor([[52.5, 0.25], [0.0, 1.0]], dtype=F64)
    assert torch.equal(climb(lambda x: torch.zeros_like(x[..., 0]), centre, REGION), centre)


def test_it_avoids_what_is_forbidden():
    centre, peak = torch.tensor([52.5, 0.25], dtype=F64), torch.tensor([55.0, 0.25], dtype=F64)

    def score(x: Tensor) -> Tensor:
        return hill(peak)(x).masked_fill(x[..., 0] > 53.0, -torch.inf)

    found = climb(score, centre, REGION)
    assert 53.0 - 5 / 32 <= found[0] <= 53.0


def test_the_score_does_not_fall_and_a_search_does_not_depend_on_the_others_of_a_batch():
    rng = torch.Generator().manual_seed(2)
    waves, phase = (
        4 * torch.randn(6, 8, 2, generator=rng, dtype=F64),
        torch.randn(6, 8, generator=rng, dtype=F64),
    )
    centre = REGION.cell_centres()[torch.tensor([0, 3, 77, 200, 311, 399])]

    def score_of(b: slice | int):
        def score(x: Tensor) -> Tensor:
            angle = (waves[b][..., None, :, :] * (x / REGION.cell)[..., None, :]).sum(-1)
            return torch.sin(angle + phase[b][..., None, :]).sum(-1)

        return score

    together = climb(score_of(slice(None)), centre, REGION)
    before, after = (score_of(slice(None))(x[:, None])[:, 0] for x in (centre, together))
    assert (after > before).all()
    for b in range(6):
        assert torch.equal(climb(score_of(b), centre[b], REGION), together[b])


def test_what_is_outside_the_region_is_forbidden():
    """The peak is beyond a slanted border: the best allowed point is on this side, nearer than the centre."""
    peak, centre = torch.tensor([56.0, 0.3], dtype=F64), torch.tensor([52.5, 0.25], dtype=F64)
    region = Region(REGION.coordinates, F64, inside=lambda x: x[..., 0] / 5 + x[..., 1] / 0.1 <= 13.6)
    found = climb(hill(peak), centre, region)
    assert region.contains(found)
    assert (hill(peak)(found[None]) > hill(peak)(centre[None])).all()
    assert not region.contains(climb(hill(peak), centre, REGION))
    outside = torch.tensor([70.0, 0.5], dtype=F64)
    assert torch.equal(climb(hill(peak), outside, region), outside)
