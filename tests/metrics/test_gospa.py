import itertools
import math

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.filter.history import history_like
from torchdt.metrics import gospa, tgospa, track_delays
from torchdt.model.distance import Euclidean

F64 = torch.float64


def score(estimates, truth, cutoff=200.0, order=1.0, dim=2):
    """GOSPA of two plain lists of points."""
    x = torch.tensor(estimates, dtype=torch.float64).reshape(len(estimates), dim)
    y = torch.tensor(truth, dtype=torch.float64).reshape(len(truth), dim)
    return gospa(x, torch.ones(len(x), dtype=bool), y, torch.ones(len(y), dtype=bool), cutoff, order)


FAR = [[0.0, 0.0], [1e4, 0.0], [0.0, 1e4]]

# name, estimates, truth, order, total, (localisation, missed, false); c = 200, alpha = 2
VECTORS = [
    ("one missed", [], FAR[:1], 1, 100, (0, 100, 0)),
    ("one false", FAR[:1], [], 1, 100, (0, 0, 100)),
    ("no truth", FAR, [], 1, 300, (0, 0, 300)),
    ("no estimates", [], FAR[:2], 1, 200, (0, 200, 0)),
    ("just inside the cutoff", [[199.0, 0]], [[0.0, 0]], 1, 199, (199, 0, 0)),
    ("at the cutoff", [[200.0, 0]], [[0.0, 0]], 1, 200, (0, 100, 100)),
    ("beyond the cutoff", [[500.0, 0]], [[0.0, 0]], 1, 200, (0, 100, 100)),
    ("near one of two", [[30.0, 40]], [[0.0, 0], [1000, 0]], 1, 150, (50, 100, 0)),
    ("greedy is wrong", [[0.0, 0], [150, 0]], [[-60.0, 0], [60, 0]], 1, 150, (150, 0, 0)),
    ("greedy is wrong, p = 2", [[0.0, 0], [150, 0]], [[-60.0, 0], [60, 0]], 2, 108.166538, (11700, 0, 0)),
    ("crossed", [[1000.0, 50], [1100, 50]], [[1100.0, 51], [1000, 52]], 1, 3, (3, 0, 0)),
    ("crossed, p = 2", [[1000.0, 50], [1100, 50]], [[1100.0, 51], [1000, 52]], 2, 2.236068, (5, 0, 0)),
    ("both empty", [], [], 1, 0, (0, 0, 0)),
    ("at the cutoff, p = 2", [[200.0, 0]], [[0.0, 0]], 2, 200, (0, 20000, 20000)),
]


@pytest.mark.parametrize(
    ("estimates", "truth", "order", "total", "parts"), [v[1:] for v in VECTORS], ids=[v[0] for v in VECTORS]
)
def test_reference_vectors(estimates, truth, order, total, parts):
    result = score(estimates, truth, order=order)
    assert result.total.item() == pytest.approx(total, rel=1e-7)
    assert (result.localisation.item(), result.missed.item(), result.false.item()) == pytest.approx(parts)
    assert (result.num_estimated, result.num_truth) == (len(estimates), len(truth))


def brute_force(x, y, cutoff, order):
    """Definition 1 of the paper: the cheapest of all partial assignments, each listed."""
    costs = []
    for size in range(min(len(x), len(y)) + 1):
        for rows in itertools.combinations(range(len(x)), size):
            for columns in itertools.permutations(range(len(y)), size):
                pairs = sum(math.dist(x[i], y[j]) ** order for i, j in zip(rows, columns, strict=True))
                costs.append(pairs + cutoff**order / 2 * (len(x) + len(y) - 2 * size))
    return min(costs) ** (1 / order)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_agrees_with_brute_force(order):
    generator = torch.Generator().manual_seed(7)
    for _ in range(60):
        num_x, num_y = torch.randint(0, 5, (2,), generator=generator).tolist()
        x = torch.rand(num_x, 3, generator=generator).tolist()
        y = torch.rand(num_y, 3, generator=generator).tolist()
        result = score(x, y, cutoff=0.5, order=order, dim=3)
        expected = brute_force(x, y, 0.5, order)
        assert result.total.item() == pytest.approx(expected, rel=1e-6)
        parts = result.localisation + result.missed + result.false
        assert parts.item() == pytest.approx(expected**order, rel=1e-6)


def test_batch_equals_single_calls():
    generator = torch.Generator().manual_seed(3)
    x = 100 * torch.randn(2, 5, 4, 2, generator=generator)
    y = 100 * torch.randn(2, 5, 3, 2, generator=generator)
    x_mask = torch.rand(2, 5, 4, generator=generator) < 0.6
    y_mask = torch.rand(2, 5, 3, generator=generator) < 0.6
    y[~y_mask] = torch.nan
    result = gospa(x, x_mask, y, y_mask, 150.0)
    assert result.total.shape == (2, 5)
    for b, k in itertools.product(range(2), range(5)):
        single = score(x[b, k][x_mask[b, k]].tolist(), y[b, k][y_mask[b, k]].tolist(), cutoff=150.0)
        for whole, alone in zip(result, single, strict=True):
            assert whole[b, k].item() == pytest.approx(alone.item(), rel=1e-6)
    assert torch.equal(result.num_estimated, x_mask.sum(-1))
    assert torch.equal(result.select(1).total, result.total[1])


@pytest.mark.parametrize(("num_x", "num_y", "total"), [(0, 2, 200.0), (2, 0, 200.0), (0, 0, 0.0)])
def test_batch_of_empty_sets(num_x, num_y, total):
    sets = torch.zeros(3, num_x, 2), torch.ones(3, num_x, dtype=bool)
    result = gospa(*sets, torch.zeros(3, num_y, 2), torch.ones(3, num_y, dtype=bool), 200.0)
    assert result.total.tolist() == [total] * 3
    assert gospa(
        *(t[:0] for t in sets), torch.zeros(0, 1, 2), torch.ones(0, 1, dtype=bool), 1.0
    ).total.shape == (0,)


def arguments(**changes):
    given = {
        "estimates": torch.zeros(4, 3, 2),
        "estimate_mask": torch.ones(4, 3, dtype=bool),
        "truth": torch.zeros(4, 2, 2),
        "truth_mask": torch.ones(4, 2, dtype=bool),
        "cutoff": 200.0,
    }
    return given | changes


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cutoff": 0.0}, "key 'cutoff': found 0.0, expected .* above zero"),
        ({"cutoff": math.nan}, "key 'cutoff': found nan"),
        ({"order": 0.5}, "key 'order': found 0.5, expected .* at least one"),
        ({"estimates": torch.zeros(3)}, r"key 'estimates': found shape \(3,\)"),
        ({"truth": torch.zeros(5, 2, 2)}, r"key 'truth': found shape \(5, 2, 2\), expected \(4, L, 2\)"),
        ({"truth": torch.zeros(4, 2, 1)}, r"key 'truth': found shape \(4, 2, 1\), expected \(4, L, 2\)"),
        ({"truth_mask": torch.ones(4, 3, dtype=bool)}, r"key 'truth_mask': .*expected .*\(4, 2\)"),
        ({"estimate_mask": torch.ones(4, 3)}, r"key 'estimate_mask': found torch.float32"),
        ({"estimates": torch.full((4, 3, 2), torch.nan)}, "key 'estimate_mask': .* not finite"),
    ],
)
def test_bad_input(changes, message):
    with pytest.raises(InputError, match=message):
        gospa(**arguments(**changes))


@pytest.mark.parametrize("metric", ["gospa", "tgospa", "delays"])
def test_a_seam_is_no_distance_for_any_metric(metric):
    """Two objects at 179 and 10, estimates at -177 and 12: 4 and 2 degrees, nothing missed."""
    truth, found = (torch.tensor(p, dtype=F64)[:, None] for p in ([179.0, 10.0], [-177.0, 12.0]))
    here, distance = torch.ones(2, dtype=torch.bool), Euclidean(period=(360.0,))
    if metric == "gospa":
        assert gospa(found, here, truth, here, 30.0, distance=distance).total.item() == 6
        scaled = Euclidean((2.0,), (360.0,))
        assert gospa(found, here, truth, here, 30.0, distance=scaled).total.item() == 3
    elif metric == "tgospa":
        assert tgospa(truth[None], found[None], 30.0, 1.0, distance=distance).total == 6
    else:
        history = history_like(1, 1, 2, 1, 2, 1, F64)
        history = history._replace(position=found[None], declared=here[None], label=torch.tensor([[1, 2]]))
        assert track_delays(history, truth[None], 30.0, distance=distance).birth == [0, 0]
