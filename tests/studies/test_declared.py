import math

import pytest
import torch
from scipy.stats import binom, poisson

from studies.declared import first_declared, level_of_half, num_begun, num_tracks, rate, share
from torchdt.filter.history import history_like
from torchdt.model.distance import EUCLIDEAN


def history(position, declared, label):
    """One coordinate, `(B, K, N)` each."""
    like = history_like(*torch.as_tensor(declared).shape, 1, 2, 1, torch.float32)
    where = torch.tensor(position, dtype=torch.float32)[..., None]
    return like._replace(position=where, declared=torch.tensor(declared), label=torch.tensor(label))


NO, YES = False, True
HISTORY = history(
    position=[[[5, 0], [5, 40], [1, 2]], [[0, 90], [0, 90], [0, 90]]],
    declared=[[[YES, NO], [NO, YES], [YES, YES]], [[NO, YES], [NO, YES], [NO, NO]]],
    label=[[[1, 0], [1, 2], [1, 3]], [[0, 1], [0, 2], [0, 0]]],
)


def test_first_declared_near_the_source():
    """Not the object of another place, nor the one that is not declared; step by step along the track."""
    track = torch.tensor([[[0.0], [50.0], [3.0]]], dtype=torch.float64).expand(2, -1, -1)
    assert first_declared(HISTORY, track, 3.0, EUCLIDEAN).tolist() == [3, math.inf]
    assert first_declared(HISTORY, track, 10.0, EUCLIDEAN).tolist() == [1, math.inf]
    assert first_declared(HISTORY, track, 10.5, EUCLIDEAN).tolist() == [1, math.inf]
    assert first_declared(HISTORY, track + 85, 10.5, EUCLIDEAN)[1] == 1


def test_tracks_are_labels_that_were_declared():
    assert num_tracks(HISTORY) == 3 + 2


def test_stretches():
    declared = torch.tensor([[True, True, False, True], [False, True, True, False], [False] * 4])
    assert num_begun(declared) == 3


@pytest.mark.parametrize("count", [0, 3, 20])
def test_share_holds_what_the_count_does_not_exclude(count):
    """The ends of the interval leave the count, and what lies beyond it, 2.5 %."""
    value, low, high = share(count, 20)
    assert value == count / 20
    assert binom.sf(count - 1, 20, low) == pytest.approx(0.025 if count else 1)
    assert binom.cdf(count, 20, high) == pytest.approx(0.025 if count < 20 else 1)


@pytest.mark.parametrize("count", [0, 4])
def test_rate_holds_what_the_count_does_not_exclude(count):
    value, low, high = rate(count, 2.0)
    assert value == count / 2
    assert poisson.sf(count - 1, 2 * low) == pytest.approx(0.025 if count else 1)
    assert poisson.cdf(count, 2 * high) == pytest.approx(0.025)


@pytest.mark.parametrize(
    ("shares", "level"),
    [
        ([0.0, 0.25, 0.75], -4.5),
        ([0.0, 0.5, 1.0], -6.0),
        ([0.6, 0.4, 0.9], -5.4),
        ([0.2, 0.25, 0.35], math.nan),
    ],
)
def test_level_of_half_is_where_it_is_passed_for_good(shares, level):
    assert level_of_half([-9, -6, -3], shares) == pytest.approx(level, nan_ok=True)


def test_levels_that_all_show_it_have_no_half():
    assert math.isnan(level_of_half([-9, -6], [0.5, 1.0]))
