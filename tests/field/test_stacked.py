"""A field per sequence equals the single fields, sequence by sequence."""

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.line_array import FREQS, POSITIONS, make_region

from torchdt.field import Field, NormalModeField
from torchdt.field.base import repeat_field
from torchdt.field.mismatch import MismatchedField
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.stacked import StackedField
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.proposal.dictionary import bartlett_surface, build_dictionary, likelihood_surface
from torchdt.model.measurement import Measurement, from_snapshots

F64 = torch.float64


@pytest.fixture(scope="module")
def fields(swellex, sensors) -> list[NormalModeField]:
    return [NormalModeField(swellex, (49.0, 148.0), sensors, tilt, dtype=F64) for tilt in (0.0, 1.0, -2.0)]


def states(*batch: int) -> torch.Tensor:
    unit = torch.rand(*batch, 4, generator=torch.Generator().manual_seed(3), dtype=F64)
    return unit * torch.tensor([4000.0, 200.0, 1.0, 1.0]) + torch.tensor([500.0, 5.0, 0.0, 0.0])


@pytest.mark.parametrize("batch", [(), (4,), (2, 5)])
def test_responses_equal_the_single_fields(fields, batch):
    stacked, state = StackedField(fields), states(3, *batch)
    assert isinstance(stacked, Field)
    assert (stacked.num_tones, stacked.num_sensors, stacked.num_coordinates) == (2, 21, 2)
    found = stacked(state)
    assert found.shape == (3, *batch, 2, 21)
    for b, field in enumerate(fields):
        torch.testing.assert_close(found[b], field(state[b]), rtol=0.0, atol=0.0)
    assert (found[0] - fields[1](state[0])).abs().max() > 0.1


@pytest.mark.parametrize("batch", [(), (4,), (2, 5)])
def test_diffuse_parts_equal_the_single_fields(fields, batch):
    shares = torch.tensor([[0.1, 0.2], [0.0, 0.5], [0.3, 0.0]], dtype=F64)
    single = [MismatchedField(f, share) for f, share in zip(fields, shares, strict=True)]
    stacked, state = StackedField(single), states(3, *batch)
    assert StackedField(fields).diffuse(state) is None
    response, diffuse = stacked(state), stacked.diffuse(state)
    assert diffuse.shape == (3, *batch, 2, 21, 21)
    for b, field in enumerate(single):
        torch.testing.assert_close(response[b], field(state[b]), rtol=0.0, atol=0.0)
        torch.testing.assert_close(diffuse[b], field.diffuse(state[b]), rtol=0.0, atol=0.0)


def test_surfaces_of_a_batch_equal_those_of_single_sequences():
    """Each sequence is searched with the responses of its own field."""
    region, speeds = make_region(), (1500.0, 1400.0, 1600.0)
    fields = [LineArrayField(FREQS, POSITIONS, speed, dtype=F64) for speed in speeds]
    rng = torch.Generator().manual_seed(4)
    data = from_snapshots(complex_normal(rng, 3, 2, 4, 8))
    noise = torch.ones(3, 2, 8, dtype=F64).diag_embed().to(torch.complex128)
    together = build_dictionary(StackedField(fields), region)
    assert together.response.shape == (3, 2, region.num_cells, 8)
    for b, field in enumerate(fields):
        alone, one = build_dictionary(field, region), Measurement(*(t[b] for t in data))
        for surface, found in (
            (bartlett_surface(alone, one), bartlett_surface(together, data)),
            (
                likelihood_surface(alone, whiten(one, noise[b])),
                likelihood_surface(together, whiten(data, noise)),
            ),
        ):
            torch.testing.assert_close(found[b], surface)
            assert (found[b - 1] - surface).abs().max() > 0.01


def test_wrong_number_of_sequences_is_refused(fields):
    with pytest.raises(ValueError, match="zip"):
        StackedField(fields)(states(2, 4))


def test_some_sequences_have_their_fields(fields):
    single = [MismatchedField(f, torch.full((2,), 0.1, dtype=F64)) for f in fields]
    stacked, state = StackedField(single), states(3, 4)
    part = stacked.select(slice(1, 3))
    assert part.fields == tuple(single[1:])
    torch.testing.assert_close(part(state[1:]), stacked(state)[1:], rtol=0.0, atol=0.0)
    assert stacked.select(slice(0, 3)) is stacked


def test_a_repeated_batch_has_its_fields_in_order(fields):
    found = repeat_field(StackedField(fields[:2]), 2)
    assert isinstance(found, StackedField)
    assert found.fields == (fields[0], fields[1], fields[0], fields[1])


def test_a_field_of_all_sequences_stays(fields):
    assert fields[0].select(slice(1, 3)) is fields[0]
    assert repeat_field(fields[0], 3) is fields[0]
