import math

import pytest
import torch

from torchdt.model.distance import EUCLIDEAN, Euclidean, GreatCircle, distances

F64 = torch.float64


def one(distance, position, other) -> float:
    return distance(torch.tensor(position, dtype=F64), torch.tensor(other, dtype=F64)).item()


def test_euclidean_distances_by_hand():
    assert one(EUCLIDEAN, [3.0, 10.0], [0.0, 14.0]) == 5
    assert one(Euclidean(scale=(100.0, 2.0)), [300.0, 10.0], [0.0, 18.0]) == 5
    assert one(Euclidean(period=(360.0, None)), [178.0, 400.0], [-179.0, 404.0]) == 5
    assert one(Euclidean((2.0, 1.0), (360.0, None)), [178.0, 400.0], [-176.0, 404.0]) == 5


@pytest.mark.parametrize(
    ("position", "other", "angle"),
    [
        ([179.0], [-179.0], 2.0),
        ([10.0], [-170.0], 180.0),
        ([0.0, 0.0], [0.0, 90.0], 90.0),
        ([0.0, 90.0], [123.0, 90.0], 0.0),
        ([0.0, 80.0], [180.0, 80.0], 20.0),
        ([0.0, 60.0], [90.0, 60.0], math.degrees(math.acos(0.75))),
        ([30.0, 12.0], [30.0, 12.000001], 1e-6),
        ([30.0, 12.0], [210.0, -12.000001], 180 - 1e-6),
    ],
)
def test_angles_along_the_great_circle(position, other, angle):
    assert one(GreatCircle(), position, other) == pytest.approx(angle, abs=1e-11)


def test_each_position_to_each_other_one():
    position, other = torch.zeros(2, 3, 1, dtype=F64), torch.zeros(2, 4, 1, dtype=F64)
    other[1, 2], position[1, 1] = 350.0, torch.nan
    found = distances(position, other, GreatCircle())
    assert found.shape == (2, 3, 4)
    assert found[1, 0].tolist() == pytest.approx([0, 0, 10, 0])
    assert found[1, 1].isnan().all()
