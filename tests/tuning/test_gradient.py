import itertools
import math

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.model.hyperparameters import HyperparameterSettings, PriorSettings
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.gradient import ascend
from torchdt.tuning.state import set_raw


def run(hyperparameters, train, heldout, state=None, **config):
    return list(ascend(hyperparameters, train, heldout, TuningConfig(**config), state))


def assert_same(ours, theirs):
    """States equal to the last bit."""
    assert ours.records == theirs.records
    for name in ("raw", "best", "good"):
        first, second = getattr(ours, name), getattr(theirs, name)
        assert first.keys() == second.keys()
        assert all(torch.equal(first[key], second[key]) for key in first)
    assert (ours.best_heldout, ours.stale, ours.finished) == (
        theirs.best_heldout,
        theirs.stale,
        theirs.finished,
    )


def test_finds_the_optimum(make, quadratic, optimum):
    hyperparameters = make()
    states = run(hyperparameters, quadratic(), quadratic(), steps=150, patience=1000)
    assert len(states) == 151
    last = states[-1]
    set_raw(hyperparameters, last.best)
    for name, value in hyperparameters.values().items():
        assert value == pytest.approx(optimum[name], rel=1e-3)
    assert last.best_heldout == pytest.approx(0, abs=1e-6)
    assert last.finished


def test_records(make, quadratic):
    """Unclipped norms and values of the step's own beginning, in units of one time step."""
    frozen = HyperparameterSettings(trainable=False, start=0.5)
    hyperparameters = make("birth_mean", survival=frozen)
    states = run(hyperparameters, quadratic(), quadratic(), steps=3, heldout_every=2, clip=0.01)
    first = states[0].records[0]
    assert first.values == {"birth_mean": pytest.approx(4e-2), "survival": 0.5}
    distance = math.log(4)
    frozen_part = math.log(9) ** 2
    assert first.objective == pytest.approx(-(distance**2) - frozen_part, rel=1e-5)
    assert first.gradient_norms == {"birth_mean": pytest.approx(2 * distance)}
    assert first.heldout == first.objective
    records = states[-1].records
    assert [r.step for r in records] == [0, 1, 2, 3]
    assert [r.heldout is not None for r in records] == [True, False, True, True]
    assert [r.passes for r in records] == [4, 7, 11, 13]
    assert records[-1].gradient_norms == {}
    assert records[1].values["birth_mean"] < 4e-2


def test_prior_pulls_the_training_objective_alone(make, quadratic):
    prior = PriorSettings(median=4e-2, spread=0.1)
    hyperparameters = make("birth_mean", birth_mean=HyperparameterSettings(prior=prior))
    last = run(hyperparameters, quadratic(), quadratic(), steps=150, patience=1000)[-1].records[-1]
    # Ten steps: 10 d^2 against (d - log 4)^2 / (2 * 0.01).
    expected = math.log(4) * 50 / 60
    assert math.log(last.values["birth_mean"] / 1e-2) == pytest.approx(expected, rel=1e-3)
    assert last.heldout == pytest.approx(-(expected**2), rel=1e-2)
    assert last.objective < last.heldout + 1


def test_best_is_that_of_the_heldout_set(make, quadratic):
    """Training pulls on beyond the held-out optimum; the ascent ends there."""
    hyperparameters = make("survival")
    slow = {"learning_rate": 0.1, "decay": 1.0}
    train = quadratic(shift=1.0)
    states = run(hyperparameters, train, quadratic(), steps=400, heldout_every=2, patience=3, **slow)
    last = states[-1]
    assert len(states) < 400
    assert (last.finished, last.stale) == (True, 3)
    set_raw(hyperparameters, last.best)
    assert hyperparameters.values()["survival"] == pytest.approx(0.9, abs=0.01)
    heldout = [r.heldout for r in last.records if r.heldout is not None]
    assert last.best_heldout == max(heldout)
    assert all(value < last.best_heldout for value in heldout[-3:])


def test_learning_rate_falls_geometrically(make, quadratic):
    """The first steps of Adam, on a gradient that hardly changes, are as long as the learning rate."""
    hyperparameters = make("survival")
    far = quadratic(shift=100.0)
    records = run(hyperparameters, far, far, steps=4, learning_rate=0.1, decay=0.0625)[-1].records
    logit = [math.log(r.values["survival"] / (1 - r.values["survival"])) for r in records]
    lengths = [abs(after - before) for before, after in itertools.pairwise(logit)]
    assert lengths == pytest.approx([0.1, 0.05, 0.025, 0.0125], rel=1e-2)


@pytest.mark.parametrize("failure", ["nan", "raise"])
def test_failed_steps_are_skipped_and_counted(make, quadratic, optimum, failure):
    train = quadratic(fail_at={3: failure, 4: failure, 20: failure})
    hyperparameters = make()
    last = run(hyperparameters, train, quadratic(), steps=150, patience=1000)[-1]
    assert last.skipped == 3
    failed = [r.step for r in last.records if r.objective is None]
    assert failed == [3, 4, 20]
    before, first, second = (last.records[k].values["survival"] for k in (2, 3, 4))
    good, bad, halved = (math.log(v / (1 - v)) for v in (before, first, second))
    assert halved == pytest.approx((good + bad) / 2, abs=1e-9)
    assert last.records[-1].values["birth_mean"] == pytest.approx(optimum["birth_mean"], rel=1e-2)


def test_gradient_that_is_not_finite(make, quadratic):
    """The objective itself is finite: at the third call its derivative is not."""
    train = quadratic()

    def steep(values):
        result = train(values)
        edge = (values["survival"] - values["survival"].detach()).abs().sqrt()  # slope infinite at zero
        return result + edge if train.calls == 3 else result

    steep.num_steps = 10
    last = run(make(), steep, quadratic(), steps=6)[-1]
    assert [r.step for r in last.records if r.objective is None] == [2]
    assert all(torch.isfinite(raw).all() for raw in last.raw.values())


def test_heldout_failure_is_no_improvement(make, quadratic):
    last = run(make(), quadratic(), quadratic(fail_at={0: "raise", 2: "nan"}), steps=10, heldout_every=5)[-1]
    assert [r.heldout is None for r in last.records if r.step % 5 == 0] == [True, False, True]
    assert last.best_heldout == last.records[5].heldout
    assert last.stale == 1


def test_start_without_likelihood(make, quadratic):
    with pytest.raises(InputError, match=r"key 'hyperparameters': found the start .*expected another start"):
        run(make(), quadratic(fail_at={0: "nan"}), quadratic())


def test_nothing_trainable(make, quadratic):
    hyperparameters = make("survival", survival=HyperparameterSettings(trainable=False))
    with pytest.raises(InputError, match="none that is trainable"):
        run(hyperparameters, quadratic(), quadratic())


def test_budget(make, quadratic):
    for budget in range(6, 40):
        passes = run(make(), quadratic(), quadratic(), budget_passes=budget)[-1].passes
        assert budget - 3 <= passes <= budget


def test_goes_on_as_if_never_stopped(make, quadratic):
    """From every step, also after a failed one, with state of the optimiser."""
    fail_at = {4: "nan", 5: "nan"}
    whole = run(make(), quadratic(fail_at=fail_at), quadratic(), steps=12, heldout_every=3)
    for k, state in enumerate(whole[:-1]):
        train = quadratic(fail_at=fail_at, calls=k + 1)
        rest = run(make(), train, quadratic(), state, steps=12, heldout_every=3)
        assert_same(rest[-1], whole[-1])
    assert run(make(), quadratic(), quadratic(), whole[-1], steps=12) == []
