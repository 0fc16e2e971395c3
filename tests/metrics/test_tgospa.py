import itertools
import math

import numpy as np
import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.filter.history import TrackHistory
from torchdt.metrics.gospa import gospa
from torchdt.metrics.tgospa import tgospa, trajectories

NAN = np.nan


def lines(*values):
    """Trajectories on a line, `(K, L, 1)`, from one list of K positions each."""
    return np.array(values, dtype=float).T[..., None]


START, END = [1.1] * 3 + [NAN] * 2, [NAN] * 3 + [1.1] * 2
NOTHING = np.zeros((5, 0, 1))

# The examples of the reference implementation by the paper's authors; c = 5, p = 1, gamma = 1:
# name, truth, estimates, total, (localisation, missed, false, switch).
REFERENCE = [
    ("offset", lines([1] * 5), lines([2] * 5), 5, (5, 0, 0, 0)),
    ("ends early", lines([1] * 5), lines([2] * 4 + [NAN]), 6.5, (4, 2.5, 0, 0)),
    ("broken", lines([1] * 5), lines(START, END), 1.5, (0.5, 0, 0, 1)),
    (
        "both broken",
        lines([1] * 5, [2.2] * 3 + [NAN] * 2, [NAN] * 3 + [2.2] * 2),
        lines(START, END, [2.1] * 5),
        3,
        (1, 0, 0, 2),
    ),
    ("crossed", lines([1] * 4, [2.2] * 4), lines([2, 2, 1.2, 1.2], [1.2, 1.2, 2, 2]), 3.6, (1.6, 0, 0, 2)),
    (
        "relieved",
        lines([1] * 4, [2.2] * 4),
        lines([2] * 4, [1.2, 1.2, NAN, NAN], [NAN, NAN, 1.2, 1.2]),
        2.6,
        (1.6, 0, 0, 1),
    ),
    ("hole", lines([0.5] * 5, [2, 2, NAN, 2, 2]), lines([1.5] * 5, [0] * 5), 7, (4.5, 0, 2.5, 0)),
    ("no estimates", lines([0.5] * 5, [2] * 5), NOTHING, 25, (0, 25, 0, 0)),
]

# One thing at a time; c = 10, p = 1, gamma = 1, distance 0.5 while assigned.
SWITCHES = [
    ("from unassigned", lines([0] * 6), lines([NAN] * 3 + [0.5] * 3), 0),  # not yet there is no switch
    ("relieved after a gap", lines([0] * 6), lines([0.5] * 2 + [NAN] * 4, [NAN] * 4 + [0.5] * 2), 1),
    ("a truth after another", lines([0] * 3 + [NAN] * 3, [NAN] * 3 + [0] * 3), lines([0.5] * 6), 1),
    ("taken and left", lines([0] * 6), lines([50, 50, 0.5, 0.5, 0.5, 0.5]), 0),  # a wrong start was one track
    # The first label loses its object to the second, and has nothing to do from then on.
    ("stolen", lines([0] * 6, [50] * 6), lines([0.5] * 3 + [90] * 3, [50.5] * 3 + [0.5] * 3), 1.5),
    ("swapped", lines([0] * 6, [50] * 6), lines([0.5] * 3 + [50.5] * 3, [50.5] * 3 + [0.5] * 3), 2),
]


def parts(result):
    return result.localisation, result.missed, result.false, result.switch


@pytest.mark.parametrize(
    ("truth", "estimates", "total", "expected"), [v[1:] for v in REFERENCE], ids=[v[0] for v in REFERENCE]
)
def test_reference_examples(truth, estimates, total, expected):
    result = tgospa(truth, estimates, 5.0, 1.0)
    assert result.total == pytest.approx(total)
    assert parts(result) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("truth", "estimates", "number"), [v[1:] for v in SWITCHES], ids=[v[0] for v in SWITCHES]
)
@pytest.mark.parametrize(("gamma", "order"), [(1.0, 1.0), (3.0, 2.0)])
def test_switches(truth, estimates, number, gamma, order):
    result = tgospa(truth, estimates, 10.0, gamma, order)
    assert result.num_switches == pytest.approx(number, abs=1e-9)
    assert result.switch == pytest.approx(number * gamma**order)
    assert result.total**order == pytest.approx(sum(parts(result)))


def random_tracks(generator, steps, number, present=0.8):
    walk = generator.normal(size=(steps, number, 2)).cumsum(0)
    walk[generator.random((steps, number)) > present] = NAN
    return walk


def matchings(num_x, num_y):
    """All partial matchings as sets of pairs."""
    for size in range(min(num_x, num_y) + 1):
        for rows in itertools.combinations(range(num_x), size):
            for columns in itertools.permutations(range(num_y), size):
                yield frozenset(zip(rows, columns, strict=True))


def cheapest(x, y, cutoff, gamma, order):
    """The paper's Definition with whole assignments: the shortest way through all matchings of all steps."""

    def step_cost(k, matching):
        cost, free_x, free_y = 0.0, set(range(x.shape[1])), set(range(y.shape[1]))
        x_here, y_here = ~np.isnan(x[k]).any(-1), ~np.isnan(y[k]).any(-1)
        for i, j in matching:
            free_x.remove(i), free_y.remove(j)
            if x_here[i] and y_here[j]:
                cost += min(math.dist(x[k, i], y[k, j]), cutoff) ** order
            else:
                cost += (x_here[i] or y_here[j]) * cutoff**order / 2
        return cost + cutoff**order / 2 * (sum(x_here[i] for i in free_x) + sum(y_here[j] for j in free_y))

    options = list(matchings(x.shape[1], y.shape[1]))
    best = [step_cost(0, option) for option in options]
    for k in range(1, len(x)):
        best = [
            step_cost(k, new)
            + min(c + gamma**order / 2 * len(new ^ old) for c, old in zip(best, options, strict=True))
            for new in options
        ]
    return min(best) ** (1 / order)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_agrees_with_brute_force(order):
    generator = np.random.default_rng(5)
    for _ in range(25):
        num_x, num_y = generator.integers(0, 4, 2)
        x, y = random_tracks(generator, 5, num_x), random_tracks(generator, 5, num_y)
        gamma = generator.choice([0.1, 1.0, 3.0])
        assert tgospa(x, y, 2.5, gamma, order).total == pytest.approx(cheapest(x, y, 2.5, gamma, order))


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_without_switch_cost_it_is_gospa_of_every_step(order):
    generator = np.random.default_rng(6)
    x, y = random_tracks(generator, 30, 3), random_tracks(generator, 30, 5)
    sets = (torch.from_numpy(t) for t in (y, x))
    arguments = [(t, ~t.isnan().any(-1)) for t in sets]
    steps = gospa(*arguments[0], *arguments[1], 2.0, order)
    result = tgospa(x, y, 2.0, 0.0, order)
    assert parts(result)[:3] == pytest.approx([float(t.sum()) for t in steps[1:4]])
    assert result.total**order == pytest.approx(float((steps.total**order).sum()))


def test_is_a_metric():
    generator = np.random.default_rng(7)
    for _ in range(10):
        x, y, z = (random_tracks(generator, 12, number) for number in (2, 3, 4))
        assert tgospa(x, x[:, ::-1], 2.0, 0.7).total == pytest.approx(0)
        forward, back = tgospa(x, y, 2.0, 0.7), tgospa(y, x, 2.0, 0.7)
        assert forward.total == pytest.approx(back.total)
        assert (forward.missed, forward.false) == pytest.approx((back.false, back.missed))
        assert forward.total <= tgospa(x, z, 2.0, 0.7).total + tgospa(z, y, 2.0, 0.7).total + 1e-9


def test_no_tracks():
    assert tgospa(NOTHING, NOTHING, 1.0, 1.0) == (0,) * 6
    assert parts(tgospa(NOTHING, lines([0] * 5), 4.0, 1.0)) == (0, 0, 10, 0)


def test_trajectories_follow_labels():
    label = torch.tensor([[3, 0], [3, 5], [5, 3], [9, 0]])  # labels move between slots; 9 is not declared
    declared = torch.tensor([[True, False], [True, True], [True, True], [False, False]])
    state = torch.arange(16.0).reshape(4, 2, 2)
    blank = torch.zeros(4)
    tracks = trajectories(TrackHistory(blank, blank, declared, label, state[..., :1], state, *[blank] * 7))
    np.testing.assert_array_equal(tracks, lines([0, 4, 10, NAN], [NAN, 6, 8, NAN]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cutoff": 0.0}, "key 'cutoff': found 0.0"),
        ({"switch_cost": -1.0}, "key 'switch_cost': found -1.0"),
        ({"order": 0.5}, "key 'order': found 0.5"),
        ({"truth": np.zeros(3)}, r"key 'truth': found shape \(3,\), expected \(K, L, d\)"),
        ({"estimates": np.zeros((4, 2, 1))}, r"key 'estimates': .*\(4, 2, 1\), expected \(5, N, 1\)"),
        ({"truth": lines([np.inf] * 5)}, "key 'truth': .* infinite"),
    ],
)
def test_bad_input(changes, message):
    given = {"truth": NOTHING, "estimates": NOTHING, "cutoff": 1.0, "switch_cost": 1.0}
    with pytest.raises(InputError, match=message):
        tgospa(**(given | changes))
