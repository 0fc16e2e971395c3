"""What tuning maximises: the log-likelihood of a set of sequences as a function of hyperparameters."""

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor

from torchdt.core.linalg import BREAKDOWN
from torchdt.model.hyperparameters import Hyperparameters


class Objective(Protocol):
    """Log-likelihood of a set of sequences, the same at every call with the same values.

    Attributes:
        num_steps: time steps with data of all sequences together, the unit of what is reported.
    """

    num_steps: int

    def __call__(self, values: Mapping[str, Tensor]) -> Tensor:
        """Log-likelihood of each sequence, `(B,)`, differentiable in the values."""
        ...


def evaluate(objective: Objective, hyperparameters: Hyperparameters, prior: bool = True) -> Tensor:
    """Log-likelihood, with the log-prior if wanted, over the number of time steps, `()` float64.

    A filter that breaks down gives NaN, without gradient.
    """
    try:
        total = objective(hyperparameters()).double().sum()
    except BREAKDOWN:
        return torch.tensor(torch.nan, dtype=torch.float64)
    log_prior = hyperparameters.log_prior()
    return (total.to(log_prior.device) + (log_prior if prior else 0.0)) / objective.num_steps


@torch.no_grad()
def value_of(objective: Objective, hyperparameters: Hyperparameters, prior: bool = True) -> float | None:
    """The same without gradient; None where it is not finite."""
    value = evaluate(objective, hyperparameters, prior)
    return value.item() if value.isfinite() else None
