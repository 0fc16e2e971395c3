import pytest
import torch

from torchdt.model.region import Coordinate, Region

RANGE = Coordinate("range", "m", 1000.0, 1100.0, 25.0, -4.0, 4.0, 1e-2)
DEPTH = Coordinate("depth", "m", 5.0, 11.0, 2.0, -1.0, 1.0, 1e-5)


def test_cells_tile_the_region():
    region = Region([RANGE, DEPTH], torch.float64)
    centres = region.cell_centres()
    assert region.num_cells == len(centres) == 12
    assert region.grid_shape == (4, 3)
    assert region.cell.tolist() == [25.0, 2.0]
    assert centres[:4].tolist() == [[1012.5, 6.0], [1012.5, 8.0], [1012.5, 10.0], [1037.5, 6.0]]
    assert centres.mean(0).tolist() == [1050.0, 8.0]
    assert region.contains(centres).all()


def test_a_whole_number_of_cells_survives_rounding():
    assert Region([Coordinate("range", "m", 0.0, 0.3, 0.1, -1, 1, 1.0)]).num_cells == 3  # 0.3 / 0.1 < 3


def test_cells_are_stretched_to_a_whole_number():
    region = Region([Coordinate("range", "m", 0.0, 100.0, 30.0, -1, 1, 1.0)])
    assert region.num_cells == 3
    assert region.cell.item() == pytest.approx(100 / 3)


def test_contains_reads_positions_only():
    region = Region([RANGE, DEPTH])
    states = torch.tensor(
        [[1050.0, 7.0, 99.0, 99.0], [999.0, 7.0, 0, 0], [1050.0, 11.5, 0, 0], [1000.0, 5.0, 0, 0]]
    )
    assert region.contains(states).tolist() == [True, False, False, True]


def test_column_names():
    assert Region([RANGE, DEPTH]).column_names == ("range_m", "depth_m", "range_rate_mps", "depth_rate_mps")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"low": 1100.0}, "found low 1100.0, high 1100.0, expected low < high"),
        ({"rate_low": 5.0}, "found rate_low 5.0, rate_high 4.0, expected rate_low < rate_high"),
        ({"cell": 0.0}, "found cell 0.0, expected"),
        ({"cell": 101.0}, "found cell 101.0, expected at most"),
        ({"driving_variance": 0.0}, "found driving_variance 0.0, expected > 0"),
    ],
)
def test_wrong_coordinates_are_named(change, message):
    with pytest.raises(ValueError, match=f"coordinate range: {message}"):
        Coordinate(**(RANGE.__dict__ | change))
