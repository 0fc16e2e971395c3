"""How much objects are doubted, from what may stand for them."""

from dataclasses import dataclass

import pytest
import torch

from torchdt.filter.bp.doubt import Doubted, doubt
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.bp.schedule import Flooding, Sequential
from torchdt.filter.bp.update import update
from torchdt.filter.interference.settings import NOTHING_ELSE, NoInterference
from torchdt.filter.state import Objects
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.base import Noise

OTHERS, TOGETHER = torch.zeros(3, 1, 2, 2), torch.ones(3, 1, 2, 2)


@dataclass
class Said:
    """What is worth so many nats."""

    others: list[float]
    together: list[float]
    echoes: list[float]
    leftovers: list[float]

    def rival(self, measurement, covariance, variance, interferers=None):
        return torch.tensor(self.together if covariance is TOGETHER else self.others)

    def echo(self, whitener, slot, moment, strength, new):
        return torch.tensor(self.echoes)

    def leftover(self, measurement, covariance, moment, power):
        assert covariance is OTHERS
        return torch.tensor(self.leftovers)


def change(said: Said) -> list[float]:
    data = from_snapshots(torch.ones(3, 1, 4, 2, dtype=torch.complex64))
    whitener = whiten(data, torch.eye(2, dtype=torch.complex64).expand(3, 1, 2, 2))
    nothing = torch.zeros(3, 1, 1)
    of = Doubted(data, OTHERS, whitener, TOGETHER, nothing, None, nothing, nothing, *[nothing] * 4)
    return doubt(of, said).tolist()


def test_odds_compare_the_best_with_it_and_the_best_without_it():
    said = Said([5.0, 1.0, 0.0], together=[1.0, 0.5, 2.0], echoes=[2.0, 4.0, 0.0], leftovers=[3.0, 0.0, 9.0])
    assert change(said) == pytest.approx([3 - 5, 0.5 - 4, 0])


def test_where_nothing_stands_for_it_nothing_changes():
    assert change(Said([0.0] * 3, [1.0] * 3, [0.0] * 3, [1.0] * 3)) == [0, 0, 0]


class Always(NoInterference):
    """Five nats for something else where the object is not."""

    signatures = 1

    def rival(self, measurement, covariance, variance, interferers=None):
        energy = covariance.diagonal(dim1=-2, dim2=-1).real.sum((-2, -1))
        return torch.where(energy < 10, 5.0, 0.0).to(energy)


@pytest.mark.parametrize("schedule", [Sequential(), Flooding()])
def test_schedules_doubt_every_object(schedule):
    """One of power 20 in noise of variance .1: what it is tested against is quiet, and it is loud."""
    response = torch.ones(1, 1, 1, 4, dtype=torch.complex128)
    one = torch.zeros(1, 1, dtype=torch.float64)
    power = torch.full((1, 1, 1), 20.0, dtype=torch.float64)
    prior = Objects(one[..., None], one, power, 0 * power, one[0], torch.zeros(1, dtype=torch.int64), one + 1)
    noise = Noise(torch.full((1, 1), 0.1, dtype=torch.float64), one)
    data = from_snapshots(torch.ones(1, 3, 4, dtype=torch.complex128))
    plain, doubted = (
        update(prior, response, noise, data, sweeps=1, schedule=schedule, interference=rivals)
        for rivals in (NOTHING_ELSE, Always())
    )
    torch.testing.assert_close(doubted.objects.log_odds, plain.objects.log_odds - 5)
