"""Gradient ascent of the likelihood by Adam (Kingma and Ba, ICLR 2015)."""

import copy
from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from torchdt.core.errors import InputError
from torchdt.core.linalg import BREAKDOWN
from torchdt.model.hyperparameters import Hyperparameters
from torchdt.tuning.config import TuningConfig
from torchdt.tuning.objective import Objective, evaluate, value_of
from torchdt.tuning.state import Record, TuningState, initial_state, note_heldout, raw_values, set_raw

PASSES_OF_GRADIENT = 3


def ascend(
    hyperparameters: Hyperparameters,
    train: Objective,
    heldout: Objective,
    config: TuningConfig,
    state: TuningState | None = None,
) -> Iterator[TuningState]:
    """Climb the training likelihood; the held-out likelihood says which values to keep and when to end.

    Step k evaluates the values theta_k, then moves on to theta_k+1; the last step evaluates alone. A step
    whose objective or gradient is not finite moves half the way back to the last values where they were: the
    random numbers are common to all steps, so that staying would fail again.

    Args:
        hyperparameters: the start; changed in place.
        train, heldout: objectives.
        config: of the ascent.
        state: where to go on; None starts.

    Yields:
        The state after each step.

    Raises:
        InputError: where nothing is trainable or the start has no finite objective and gradient.
    """
    state = state or initial_state(hyperparameters)
    set_raw(hyperparameters, state.raw)
    optimizer = torch.optim.Adam(hyperparameters.parameters(), lr=config.learning_rate)
    if state.optimizer:
        optimizer.load_state_dict(state.optimizer)
    while not state.finished:
        step, raw, values = len(state.records), raw_values(hyperparameters), hyperparameters.values()
        last = step == config.steps or not _affordable(state, config)
        objective, norms = (
            (value_of(train, hyperparameters), {}) if last else _differentiate(train, hyperparameters)
        )
        skipped, good = (state.skipped + 1, state.good) if objective is None else (state.skipped, raw)
        passes = state.passes + (1 if last else PASSES_OF_GRADIENT)
        best, best_heldout, stale, held = state.best, state.best_heldout, state.stale, None
        if last or step % config.heldout_every == 0:
            held = value_of(heldout, hyperparameters, prior=False)
            passes += 1
            best, best_heldout, stale = note_heldout(state, raw, held)
        if not last:
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * config.decay ** (step / config.steps)
            _move(hyperparameters, optimizer, config.clip, raw, good, finite=objective is not None)
        state = TuningState(
            raw=raw_values(hyperparameters),
            best=best,
            best_heldout=best_heldout,
            stale=stale,
            good=good,
            optimizer=copy.deepcopy(optimizer.state_dict()),  # the next step writes into its tensors
            records=(*state.records, Record(step, values, objective, norms, held, skipped, passes)),
            finished=last or stale >= config.patience,
        )
        yield state


def _affordable(state: TuningState, config: TuningConfig) -> bool:
    """Whether the budget covers a gradient step and then the last evaluation, both with a held-out pass."""
    needed = PASSES_OF_GRADIENT + 1 + 2
    return config.budget_passes is None or state.passes + needed <= config.budget_passes


def _differentiate(
    train: Objective, hyperparameters: Hyperparameters
) -> tuple[float | None, dict[str, float]]:
    """Objective, and the norm of its gradient by name; the gradient of its negative is left in `grad`."""
    hyperparameters.zero_grad()
    objective = evaluate(train, hyperparameters)
    if not objective.isfinite():
        return None, {}
    try:
        (-objective).backward()
    except BREAKDOWN:  # checkpointing runs the filter again
        return None, {}
    norms = {
        name: 0.0 if value.grad is None else value.grad.norm().item()
        for name, value in hyperparameters.named_parameters()
    }
    finite = all(torch.tensor(list(norms.values())).isfinite())
    return objective.item() if finite else None, norms


def _move(
    hyperparameters: Hyperparameters,
    optimizer: torch.optim.Optimizer,
    clip: float,
    raw: dict[str, Tensor],
    good: dict[str, Tensor],
    finite: bool,
) -> None:
    if finite:
        clip_grad_norm_(hyperparameters.parameters(), clip)
        optimizer.step()
        return
    if not good:
        found = f"the start {hyperparameters.values()}, without a finite likelihood and gradient"
        raise InputError.of_key("hyperparameters", found, "another start")
    set_raw(hyperparameters, {name: torch.lerp(raw[name], good[name], 0.5) for name in raw})
