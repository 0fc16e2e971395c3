"""What may be heard beside objects, as the filter asks for it."""

import pytest
import torch
from oracles.arrays import complex_normal
from oracles.interferers import any_level
from oracles.line_array import make_tracker

from torchdt.core.errors import InputError
from torchdt.filter.interference.interfered import Interfered
from torchdt.filter.interference.settings import FreeSignatures, Interference, NoInterference, beside
from torchdt.filter.interference.signatures import Interferers, free_gains, price
from torchdt.model.measurement import from_snapshots
from torchdt.model.noise.white import WHITE

F64 = torch.float64
SILENT, LOUD = 0, 1


@pytest.fixture
def heard():
    """Two sequences, of noise and of noise with a loud signal; beliefs about a noise of variance one."""
    rng = torch.Generator().manual_seed(1)
    snapshots = complex_normal(rng, 2, 2, 3, 8)
    snapshots[LOUD] += 10 * complex_normal(rng, 2, 3, 1) * complex_normal(rng, 2, 1, 8)
    return from_snapshots(snapshots), WHITE, any_level(2, 2), torch.zeros(2, 2, 8, 8, dtype=torch.complex128)


def before(number: int) -> torch.Tensor:
    return torch.zeros(2, 2, 8, number, dtype=torch.complex128)


def test_nothing_is_nothing(heard):
    measurement, *_ = heard
    nothing = NoInterference()
    assert isinstance(nothing, Interference)
    found = nothing.follow(*heard, before(0), new=True)
    assert not found.any
    assert found.cost.eq(0).all()
    eye, variance = torch.eye(8, dtype=torch.complex128), torch.ones(2, 2, dtype=F64)
    assert nothing.rival(measurement, eye.expand(2, 2, 8, 8), variance).tolist() == [0, 0]


def test_a_loud_signal_begins_where_it_may(heard):
    free = FreeSignatures()
    assert isinstance(free, Interference)
    assert not free.follow(*heard, before(3), new=False).any
    found = free.follow(*heard, before(3), new=True).columns != 0
    assert not found[SILENT].any()
    assert found[LOUD].any(-2).any(-1).all()


def test_a_sequence_is_in_a_batch_what_it_is_alone(heard):
    measurement, _, noise, signal = heard
    free = FreeSignatures()
    together = free.follow(*heard, before(3), new=True)
    for b in (SILENT, LOUD):
        parts = [type(t)(*(part[b : b + 1] for part in t)) for t in (measurement, noise)]
        alone = free.follow(parts[0], WHITE, parts[1], signal[:1], before(3)[:1], new=True)
        torch.testing.assert_close(alone.covariance[0], together.covariance[b], rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(alone.cost[0], together.cost[b], rtol=1e-9, atol=1e-9)


def test_a_rival_is_what_exceeds_the_price(heard):
    measurement, *_ = heard
    eye, variance = torch.eye(8, dtype=torch.complex128).expand(2, 2, 8, 8), torch.ones(2, 2, dtype=F64)
    found = FreeSignatures(signatures=2).rival(measurement, eye, variance)
    gain = free_gains(measurement, eye, 2) - price(measurement, variance)[..., None]
    torch.testing.assert_close(found, torch.logaddexp(gain, torch.zeros_like(gain)).sum((-2, -1)))
    assert found[SILENT] < 0.1
    assert found[LOUD] > 100


def test_what_stands_beside_the_noise():
    nothing = Interferers(before(3), torch.zeros(2, 2), before(3))
    assert beside(WHITE, None) is WHITE
    assert beside(WHITE, nothing) is WHITE
    columns = before(3)
    columns[LOUD, 0, :, 1] = 1.0
    found = beside(WHITE, nothing._replace(columns=columns))
    assert isinstance(found, Interfered)
    assert found.columns is columns


@pytest.mark.parametrize(
    ("name", "value"), [("signatures", 0), ("signatures", 1.5), ("memory", -1.0), ("memory", float("nan"))]
)
def test_bad_numbers_are_named(name, value):
    with pytest.raises(InputError, match=f"'tracker.interference.{name}': found {value}"):
        FreeSignatures(**{name: value})


def test_a_tracker_wants_one_of_them():
    with pytest.raises(InputError, match=r"'tracker.interference': found .*Interference"):
        make_tracker(interference="none")
