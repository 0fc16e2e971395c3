"""Beliefs after one step beside the sum over all associations and existences."""

import pytest
import torch
from oracles.association import enumerate_associations
from torch import Tensor

from torchdt.baselines.mot.config import PointConfig
from torchdt.baselines.mot.update import Known, update
from torchdt.core.linalg import NumericalError

F64 = torch.float64
CONFIG = PointConfig(
    detection_probability=0.8, clutter_mean=2.0, birth_mean=0.3, tolerance=1e-13, iterations=10_000
)


def problem(seed: int, num: int, points: int, particles: int = 6) -> list[Tensor]:
    """Arguments of `update`."""
    rng = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return 1.5 * torch.randn(*shape, generator=rng, dtype=F64)

    log_weight = normal(num, particles).log_softmax(-1)
    return [log_weight, normal(num), normal(num, points, particles), normal(points), normal(points)]


def exact(arguments: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Probability of each particle of a known object `(N, P)`, its existence `(N,)`, and that of new ones."""
    log_weight, log_odds, log_likelihood, new_log_likelihood, log_clutter = arguments
    r, p_d, clutter = torch.sigmoid(log_odds), CONFIG.detection_probability, CONFIG.clutter_mean
    clutter = clutter * log_clutter.exp()
    joint = r[:, None, None] * p_d * (log_weight[:, None] + log_likelihood).exp() / clutter[:, None]
    missed = (r * (1 - p_d))[:, None] * log_weight.exp()
    new = CONFIG.birth_mean * new_log_likelihood.exp() / clutter
    legacy = torch.cat([(1 - r + missed.sum(-1))[:, None], joint.sum(-1)], -1)
    marginals, free = enumerate_associations(legacy.log(), (1 + new).log())
    none = missed / legacy[:, :1] * marginals[:, :1]
    state = none + (joint / legacy[:, 1:, None] * marginals[:, 1:, None]).sum(-2)
    return state, state.sum(-1), free * new / (1 + new)


def agrees(found: tuple[Known, Tensor], arguments: list[Tensor], atol: float) -> None:
    known, new = found
    state, existence, new_existence = exact(arguments)
    close = {"rtol": 0, "atol": atol}
    torch.testing.assert_close(torch.sigmoid(known.log_odds), existence, **close)
    torch.testing.assert_close(known.log_weight.exp(), state / existence[:, None], **close)
    torch.testing.assert_close(torch.sigmoid(new), new_existence, **close)


@pytest.mark.parametrize(("num", "points"), [(1, 1), (1, 2), (1, 5), (2, 1), (4, 1)])
def test_exact_for_one_object_or_one_point(num, points):
    for seed in range(5):
        arguments = problem(seed, num, points)
        agrees(update(*arguments, CONFIG), arguments, 1e-9)


def test_close_for_several_objects_and_points():
    """Largest error found over these cases: 0.03."""
    for seed in range(12):
        arguments = problem(seed, 2 + seed % 3, 2 + seed // 3 % 3)
        agrees(update(*arguments, CONFIG), arguments, 0.06)


@pytest.mark.parametrize("points", [1, 3])
def test_probabilities_of_the_points_given_existence(points):
    """For one object: its terms of the sum, normalised."""
    log_weight, log_odds, log_likelihood, new, log_clutter = problem(7, 1, points)
    known, _ = update(log_weight, log_odds, log_likelihood, new, log_clutter, CONFIG)
    clutter = CONFIG.clutter_mean * log_clutter.exp()
    xi = 1 + CONFIG.birth_mean * new.exp() / clutter
    detected = 0.8 * (log_weight[:, None] + log_likelihood).exp().sum(-1) / clutter / xi
    expected = torch.cat([torch.full((1, 1), 0.2, dtype=F64), detected], -1)
    torch.testing.assert_close(known.taken, expected / expected.sum(-1, keepdim=True))


def test_points_and_objects_that_are_not_there_change_nothing():
    log_weight, log_odds, log_likelihood, new, log_clutter = problem(8, 2, 3)
    expected, expected_new = update(log_weight, log_odds, log_likelihood, new, log_clutter, CONFIG)
    known, found_new = update(
        torch.cat([log_weight, log_weight[:1]]),
        torch.cat([log_odds, torch.tensor([-torch.inf], dtype=F64)]),
        torch.nn.functional.pad(log_likelihood, (0, 0, 0, 2, 0, 1), value=3.0),
        torch.cat([new, new[:2]]),
        torch.cat([log_clutter, torch.full((2,), torch.inf, dtype=F64)]),
        CONFIG,
    )
    for name in ("log_weight", "log_odds"):
        torch.testing.assert_close(getattr(known, name)[:2], getattr(expected, name))
    torch.testing.assert_close(known.taken[:2, :4], expected.taken)
    assert known.taken[:, 4:].eq(0).all()
    assert known.log_odds[2].isneginf()
    assert known.log_weight.isfinite().all()
    torch.testing.assert_close(found_new[:3], expected_new)
    assert found_new[3:].isneginf().all()


def test_without_points_only_missing_counts():
    log_weight, log_odds, _, _, _ = problem(9, 3, 1)
    known, _ = update(
        log_weight,
        log_odds,
        torch.zeros(3, 1, 6, dtype=F64),
        torch.zeros(1, dtype=F64),
        torch.tensor([torch.inf], dtype=F64),
        CONFIG,
    )
    r = torch.sigmoid(log_odds)
    torch.testing.assert_close(torch.sigmoid(known.log_odds), 0.2 * r / (1 - 0.8 * r))
    torch.testing.assert_close(known.log_weight, log_weight)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_a_point_that_no_particle_can_explain(dtype):
    """A likelihood of zero throughout is a missed detection, not a NaN."""
    log_weight, log_odds, log_likelihood, new, log_clutter = (t.to(dtype) for t in problem(10, 2, 2))
    log_likelihood[0] = -torch.inf
    known, found_new = update(log_weight, log_odds, log_likelihood, new, log_clutter, CONFIG)
    torch.testing.assert_close(known.log_weight[0], log_weight[0])
    assert known.taken[0].tolist() == [1, 0, 0]
    assert all(t.isfinite().all() for t in (*known, found_new))


def test_particles_without_weight_get_none():
    log_weight, log_odds, log_likelihood, new, log_clutter = problem(11, 2, 2)
    log_weight[:, 3] = -torch.inf
    log_weight = log_weight.log_softmax(-1)
    log_likelihood[..., 3] = 1e3
    arguments = [log_weight, log_odds, log_likelihood, new, log_clutter]
    known, _ = update(*arguments, CONFIG)
    assert known.log_weight[:, 3].isneginf().all()
    torch.testing.assert_close(known.log_weight.exp().sum(-1), torch.ones(2, dtype=F64))


@pytest.mark.parametrize("which", [2, 3])
@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_a_likelihood_that_is_no_number_is_an_error(which, value):
    arguments = problem(12, 2, 2)
    arguments[which][0] = value
    with pytest.raises(NumericalError, match=r"likelihood of a point given a (known|new) object"):
        update(*arguments, CONFIG)
