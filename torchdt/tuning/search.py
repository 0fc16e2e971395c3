"""Black-box search of the likelihood, without gradients: tree-structured Parzen estimator and grid.

Both look into the box `start +- width` of the unconstrained values, and both begin with the start.
"""

import itertools
from collections.abc import Generator, Iterator
from types import ModuleType

import torch
from torch import Tensor
from torch.nn.utils import vector_to_parameters

from torchdt.core.errors import InputError, require
from torchdt.model.hyperparameters import Hyperparameters
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.objective import Objective, value_of
from torchdt.tuning.state import Record, TuningState, initial_state, note_heldout, raw_values

# Points to evaluate go out, the objective of each comes in; None for one that is not finite.
Proposals = Generator[Tensor, float | None, None]


def grid(start: Tensor, width: float, number: int) -> Proposals:
    """The start, then the finest regular grid of at most `number - 1` points.

    Args:
        start: `(D,)` unconstrained values.
        width: half the side of the box.
        number: of evaluations, at most.

    Raises:
        InputError: where these are too few for two points per dimension.
    """
    dims = len(start)
    side = next(n for n in itertools.count(1) if (n + 1) ** dims > number - 1)
    found = f"{number} evaluations, with a held-out one each"
    expected = f"{2**dims + 1} or more for a grid over {dims} values"
    require(side >= 2, "tuning.budget_passes", found, expected)
    yield start
    for offset in itertools.product(torch.linspace(-width, width, side).tolist(), repeat=dims):
        if any(offset):  # the start itself is known
            yield start + start.new_tensor(offset)


def tpe(start: Tensor, width: float, seed: int) -> Proposals:
    """Endless proposals of a tree-structured Parzen estimator (Bergstra et al., NeurIPS 2011) by Optuna.

    Args:
        start: `(D,)` unconstrained values.
        width: half the side of the box.
        seed: of the proposals.

    Raises:
        InputError: where Optuna is not installed.
    """
    optuna = _optuna()
    space = {
        f"{d:03d}": optuna.distributions.FloatDistribution(centre - width, centre + width)
        for d, centre in enumerate(start.tolist())
    }
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=seed))
    study.enqueue_trial(dict(zip(space, start.tolist(), strict=True)))
    while True:
        trial = study.ask(space)
        value = yield start.new_tensor([trial.params[name] for name in space])
        failed = optuna.trial.TrialState.FAIL
        study.tell(trial, value, state=failed if value is None else None)


def _optuna() -> ModuleType:
    try:
        import optuna
    except ImportError as error:
        expected = "Optuna: pip install 'torchdt[tune]'"
        raise InputError.of_key("tuning.method", "tpe without Optuna", expected) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def search(
    hyperparameters: Hyperparameters,
    train: Objective,
    heldout: Objective,
    config: TuningConfig,
    state: TuningState | None = None,
) -> Iterator[TuningState]:
    """Evaluate proposals until the budget is spent; values better than all before are held out as well.

    A search goes on by telling the proposals once more what is known of them.

    Args:
        hyperparameters: the start; changed in place.
        train, heldout: objectives.
        config: `method` is `tpe` or `grid`.
        state: where to go on; None starts.

    Yields:
        The state after each evaluation; `raw` is the start throughout.

    Raises:
        InputError: where nothing is trainable, the budget is too small or Optuna is not installed.
    """
    state = state or initial_state(hyperparameters)
    start = torch.cat([state.raw[name].flatten() for name, _ in hyperparameters.named_parameters()])
    assert config.budget_passes is not None
    proposals = (
        tpe(start, config.width, config.seed)
        if config.method == "tpe"
        else grid(start, config.width, config.budget_passes // 2)
    )
    point = next(proposals, None)
    for record in state.records:
        point = _answer(proposals, record.objective)
    while not state.finished and point is not None:
        vector_to_parameters(point, hyperparameters.parameters())
        objective = value_of(train, hyperparameters)
        known = [record.objective for record in state.records if record.objective is not None]
        passes, held = state.passes + 1, None
        best, best_heldout, stale = state.best, state.best_heldout, state.stale
        if objective is not None and objective > max(known, default=-torch.inf):
            held = value_of(heldout, hyperparameters, prior=False)
            passes += 1
            best, best_heldout, stale = note_heldout(state, raw_values(hyperparameters), held)
        skipped = state.skipped + (objective is None)
        record = Record(len(state.records), hyperparameters.values(), objective, {}, held, skipped, passes)
        point = _answer(proposals, objective)
        state = TuningState(
            raw=state.raw,
            best=best,
            best_heldout=best_heldout,
            stale=stale,
            records=(*state.records, record),
            finished=point is None or passes + 2 > config.budget_passes,
        )
        yield state


def _answer(proposals: Proposals, objective: float | None) -> Tensor | None:
    """Tell the value of the last proposal and take the next; None where there is no more."""
    try:
        return proposals.send(objective)
    except StopIteration:
        return None
