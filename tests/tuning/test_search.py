import sys
from unittest import mock

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.search import grid, search, tpe
from torchdt.tuning.state import set_raw


def run(hyperparameters, train, heldout, method, state=None, **config):
    return list(search(hyperparameters, train, heldout, TuningConfig(method=method, **config), state))


@pytest.fixture(params=["grid", "tpe"])
def method(request):
    if request.param == "tpe":
        pytest.importorskip("optuna", reason="the extra torchdt[tune] is not installed")
    return request.param


def test_finds_the_optimum(make, quadratic, optimum, method):
    hyperparameters = make("survival", "birth_mean")
    last = run(hyperparameters, quadratic(), quadratic(), method, budget_passes=200)[-1]
    set_raw(hyperparameters, last.best)
    found = hyperparameters.values()
    # A grid of nine points a side is half a unit apart.
    assert abs(torch.logit(torch.tensor(found["survival"])) - torch.logit(torch.tensor(0.9))) < 0.3
    assert abs(torch.log(torch.tensor(found["birth_mean"] / optimum["birth_mean"]))) < 0.3
    assert last.best_heldout == max(r.heldout for r in last.records if r.heldout is not None)
    assert last.finished
    assert last.passes <= 200


def test_begins_with_the_start_and_stays_in_the_box(make, quadratic, method):
    records = run(make("birth_mean"), quadratic(), quadratic(), method, budget_passes=30, width=0.5)[
        -1
    ].records
    assert records[0].values["birth_mean"] == pytest.approx(4e-2)
    ratios = torch.tensor([r.values["birth_mean"] / 4e-2 for r in records]).log()
    assert ratios.abs().max() <= 0.5 + 1e-5
    assert len(set(ratios.tolist())) == len(records)


def test_only_improvements_are_held_out(make, quadratic, method):
    records = run(make(), quadratic(), quadratic(), method, budget_passes=60)[-1].records
    best, passes = -torch.inf, 0
    for record in records:
        assert (record.heldout is not None) == (record.objective > best)
        best = max(best, record.objective)
        passes += 1 if record.heldout is None else 2
        assert record.passes == passes
        assert record.gradient_norms == {}


def test_failed_evaluations_are_counted(make, quadratic, method):
    train = quadratic(fail_at={0: "nan", 3: "raise"})
    last = run(make("survival"), train, quadratic(), method, budget_passes=30)[-1]
    assert [r.step for r in last.records if r.objective is None] == [0, 3]
    assert last.skipped == 2
    assert last.best_heldout is not None


def test_goes_on_as_if_never_stopped(make, quadratic, method):
    """Beyond the ten random proposals with which the estimator begins."""
    fail_at = {2: "nan"}
    whole = run(make(), quadratic(fail_at=fail_at), quadratic(), method, budget_passes=60)
    assert len(whole) > 16
    for k in (0, 2, 15, len(whole) - 2):
        train = quadratic(fail_at=fail_at, calls=k + 1)
        rest = run(make(), train, quadratic(), method, whole[k], budget_passes=60)
        assert rest[-1].records == whole[-1].records
        assert all(torch.equal(rest[-1].best[name], whole[-1].best[name]) for name in whole[-1].best)
    assert run(make(), quadratic(), quadratic(), method, whole[-1], budget_passes=60) == []


def test_grid_is_regular():
    points = torch.stack(list(grid(torch.tensor([1.0, 2.0]), 0.5, 11)))
    assert points[0].tolist() == [1.0, 2.0]
    assert sorted(points[1:].tolist()) == [
        [x, y] for x in (0.5, 1.0, 1.5) for y in (1.5, 2.0, 2.5) if (x, y) != (1, 2)
    ]


def test_grid_needs_two_points_a_side(make, quadratic):
    assert len(list(grid(torch.zeros(4), 1.0, 17))) == 17
    with pytest.raises(InputError, match=r"key 'tuning.budget_passes'.*17 or more for a grid over 4 values"):
        run(make(), quadratic(), quadratic(), "grid", budget_passes=33)


def test_proposals_depend_on_the_seed():
    pytest.importorskip("optuna", reason="the extra torchdt[tune] is not installed")

    def second(seed):
        proposals = tpe(torch.zeros(2), 1.0, seed)
        next(proposals)
        return proposals.send(0.0).tolist()

    assert second(3) == second(3)
    assert second(3) != second(4)


def test_without_optuna():
    with mock.patch.dict(sys.modules, optuna=None), pytest.raises(InputError, match=r"torchdt\[tune\]"):
        next(tpe(torch.zeros(1), 1.0, 0))
