import math

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.model.birth import Birth, UniformBirth
from torchdt.model.birth_areas import Area, AreaBirth
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
PLANE = Region(
    [Coordinate("x", "m", 0, 4, 1, -1, 1, 1.0), Coordinate("y", "m", 10, 16, 2, -1, 1, 1.0)],
    F64,
    inside=lambda state: state[..., 0] < 2.9,
)


def test_odds_are_the_share_of_the_areas_in_each_cell():
    """One area over a cell and a half of x and all of y, another in a corner that the region leaves out."""
    areas = [Area([0.5, 10.0], [2.0, 16.0], 2.0), {"low": [3.0, 10.0], "high": [4.0, 12.0]}]
    birth = AreaBirth(0.3, areas).on(PLANE)
    assert isinstance(birth, Birth)
    odds = birth.log_odds(PLANE, PLANE.cell_centres()).exp().reshape(4, 3)
    row = torch.tensor([1 / 9, 2 / 9, 0, 0], dtype=F64)  # of 0.3, in each of three cells of y
    torch.testing.assert_close(odds, 0.3 * row[:, None].expand(4, 3))
    edges = torch.tensor([[0.99, 10.1], [1.01, 15.9], [2.01, 11.0]], dtype=F64)
    torch.testing.assert_close(
        birth.log_odds(PLANE, edges).exp(), 0.3 * torch.tensor([1 / 9, 2 / 9, 0], dtype=F64)
    )


def test_probability_of_no_birth_is_the_product_over_the_cells():
    mean = torch.tensor([0.3, 2.0], dtype=F64)
    birth = AreaBirth(mean, [Area([0.0, 10.0], [2.0, 16.0])]).on(PLANE)
    places = torch.tensor([[[0.5, 11.0], [1.5, 13.0]], [[3.5, 11.0], [0.5, 11.0]]], dtype=F64)
    looked_at = birth.log_odds(PLANE, places)  # two cells of six, and one
    found = birth.log_none(PLANE, looked_at)
    torch.testing.assert_close(found, -torch.tensor([4, 5]) * torch.log1p(mean / 6))


def test_the_whole_region_is_a_uniform_birth():
    mean = torch.tensor(0.3, dtype=F64)
    births = AreaBirth(mean, [Area([0.0, 10.0], [4.0, 16.0])]).on(PLANE), UniformBirth(mean)
    position = PLANE.cell_centres()[PLANE.is_birth_cell]
    torch.testing.assert_close(*(b.log_odds(PLANE, position) for b in births))
    none = torch.full((2,), -torch.inf, dtype=F64)
    torch.testing.assert_close(*(b.log_none(PLANE, none) for b in births))


@pytest.mark.parametrize(
    ("areas", "words"),
    [
        ([], "areas': found none, expected one area or more"),
        ([{"low": [0.0, 10.0]}], r"areas\[0\]': found .*expected values of"),
        (
            [{"low": [0.0], "high": [1.0, 12.0]}],
            r"areas\[0\].low': found \[0.0\], expected one number for each of 2",
        ),
        ([{"low": [1.0, 10.0], "high": [1.0, 12.0]}], r"areas\[0\].low': found .*a corner below high"),
        ([{"low": [1.0, 10.0], "high": [2.0, 12.0], "weight": 0.0}], r"areas\[0\].weight': found 0.0"),
        ([{"low": [1.0, 10.0], "high": [math.inf, 12.0]}], r"areas\[0\].high': found .*finite"),
        ([{"low": [3.1, 10.0], "high": [4.0, 12.0]}], "no cell of the region"),
    ],
)
def test_areas_that_make_no_sense(areas, words):
    with pytest.raises(InputError, match=words):
        AreaBirth(0.1, areas).on(PLANE)
