import math

import pytest
import torch

from recordings.tart_score import sky_gospa, sky_score, towards


def at(zenith, azimuth=0.0):
    """Direction cosines of an angle from the zenith, degrees."""
    z, a = math.radians(zenith), math.radians(azimuth)
    return [math.sin(z) * math.sin(a), math.sin(z) * math.cos(a)]


def tensor(values):
    return torch.tensor(values, dtype=torch.float64)


def test_unit_vectors():
    torch.testing.assert_close(towards(tensor([[0.6, 0.0], [0.0, 0.0]])), tensor([[0.6, 0, 0.8], [0, 0, 1]]))


@pytest.mark.parametrize("zenith", [0.0, 40.0, 75.0])
def test_degrees_are_those_of_the_sphere(zenith):
    """However much a degree shrinks in direction cosines towards the horizon."""
    yes = torch.ones(1, 1, dtype=torch.bool)
    score = sky_gospa(tensor([[at(zenith + 3)]]), yes, tensor([[at(zenith)]]))
    assert score.total.item() == pytest.approx(3, rel=1e-3)
    far = sky_gospa(tensor([[at(zenith + 5.1)]]), yes, tensor([[at(zenith)]]))
    assert (far.missed.item(), far.false.item()) == (2.5, 2.5)


def test_scores():
    """Two steps: errors of 1, 3 degrees, then 1; one satellite is absent in the second step."""
    truth = tensor([[at(20), at(60)], [at(20), [math.nan, math.nan]]])
    position = tensor([[at(21), at(57)], [at(21), at(0)]])
    declared = torch.tensor([[True, True], [True, False]])
    label = torch.tensor([[1, 2], [1, 0]])
    score = sky_score(position, declared, label, torch.ones(2, 2), truth)
    assert score.declared == 1.5
    assert score.close == pytest.approx(2 / 3)
    assert score.median_error == pytest.approx(1)
    assert score.gospa == pytest.approx((4 + 1) / 2, rel=1e-3)
    assert score.switches == 0


def test_switches_are_counted_over_gaps():
    truth = tensor([[at(20)]] * 4)
    position, declared = tensor([[at(20)]] * 4), torch.tensor([[True], [False], [True], [True]])
    label = torch.tensor([[3], [0], [5], [3]])
    assert sky_score(position, declared, label, torch.ones(4, 1), truth).switches == 2


def test_switches_of_weak_satellites_do_not_count():
    places = [at(10 * n) for n in range(1, 8)]
    truth = position = tensor([places] * 2)
    power = torch.arange(7.0, 0, -1).expand(2, 7)
    label = torch.tensor([[1, 2, 3, 4, 5, 6, 7], [1, 2, 3, 4, 5, 6, 8]])
    declared = torch.ones(2, 7, dtype=torch.bool)
    assert sky_score(position, declared, label, power, truth).switches == 0
    assert sky_score(position, declared, label, power.flip(-1), truth).switches == 1


def test_nothing_declared():
    score = sky_score(
        tensor([[at(20)]]), torch.zeros(1, 1, dtype=torch.bool), None, torch.ones(1, 1), tensor([[at(20)]])
    )
    assert math.isnan(score.median_error)
    assert score.gospa == 2.5
    assert score.switches is None
