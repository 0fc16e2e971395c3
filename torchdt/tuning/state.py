"""Where a tuning run stands: all that the next step depends on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.model.hyperparameters import Hyperparameters

Values = dict[str, float | list[float]]


@dataclass(frozen=True)
class Record:
    """One step.

    Attributes:
        step: counted from zero.
        values: constrained values that this step evaluated.
        objective: training log-likelihood, with the log-prior, over the number of time steps; None where it
            or its gradient was not finite.
        gradient_norms: of the objective in each unconstrained value, before clipping; empty without gradient.
        heldout: held-out log-likelihood per time step at the same values; None where not evaluated.
        skipped: steps so far without a finite objective and gradient.
        passes: filter passes so far.
    """

    step: int
    values: Values
    objective: float | None
    gradient_norms: dict[str, float]
    heldout: float | None
    skipped: int
    passes: int


@dataclass(frozen=True)
class TuningState:
    """A tuning run between two steps.

    Attributes:
        raw: unconstrained values that the next step starts from, by name.
        best: those of the best held-out log-likelihood so far.
        best_heldout: that log-likelihood per time step; None before the first finite one.
        stale: held-out evaluations since then.
        good: the last unconstrained values with a finite objective and gradient; empty before.
        optimizer: state of Adam; empty for other methods and before the first step.
        records: one per step.
        finished: no step is left to do.
    """

    raw: dict[str, Tensor]
    best: dict[str, Tensor]
    best_heldout: float | None = None
    stale: int = 0
    good: dict[str, Tensor] = field(default_factory=dict)
    optimizer: dict[str, Any] = field(default_factory=dict)
    records: tuple[Record, ...] = ()
    finished: bool = False

    @property
    def passes(self) -> int:
        """Filter passes so far."""
        return self.records[-1].passes if self.records else 0

    @property
    def skipped(self) -> int:
        """Steps so far without a finite objective and gradient."""
        return self.records[-1].skipped if self.records else 0


def initial_state(hyperparameters: Hyperparameters) -> TuningState:
    """State before the first step.

    Raises:
        InputError: where nothing is trainable.
    """
    raw = raw_values(hyperparameters)
    require(bool(raw), "hyperparameters", "none that is trainable", "at least one to tune")
    return TuningState(raw, raw)


def raw_values(hyperparameters: Hyperparameters) -> dict[str, Tensor]:
    """Copies of the trainable unconstrained values by name."""
    return {name: value.detach().clone() for name, value in hyperparameters.named_parameters()}


def set_raw(hyperparameters: Hyperparameters, raw: Mapping[str, Tensor]) -> None:
    """Set the trainable unconstrained values."""
    with torch.no_grad():
        for name, value in hyperparameters.named_parameters():
            value.copy_(raw[name])


def note_heldout(
    state: TuningState, raw: dict[str, Tensor], heldout: float | None
) -> tuple[dict[str, Tensor], float | None, int]:
    """`best`, `best_heldout` and `stale` after one more held-out evaluation."""
    if heldout is not None and (state.best_heldout is None or heldout > state.best_heldout):
        return raw, heldout, 0
    return state.best, state.best_heldout, state.stale + 1


def numbers(values: Mapping[str, float | list[float]]) -> dict[str, float]:
    """One number for each name; entry n of a vector is `name_n`, counted from one."""
    found: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, list):
            found.update({f"{name}_{n}": entry for n, entry in enumerate(value, 1)})
        else:
            found[name] = value
    return found
