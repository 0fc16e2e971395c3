from dataclasses import dataclass, field

import pytest
import torch

from torchdt.core.linalg import NumericalError
from torchdt.field.mismatch import MISMATCH_SHARE
from torchdt.model.hyperparameters import Hyperparameters, HyperparameterSettings
from torchdt.model.model import Model

OPTIMUM = {"survival": 0.9, "birth_mean": 1e-2, "mismatch_share": [0.2, 0.05]}
START = {"survival": 0.6, "birth_mean": 4e-2, "mismatch_share": [0.1, 0.1]}


@dataclass
class Quadratic:
    """Log-likelihoods of two sequences of five steps, quadratic in the unconstrained values.

    `shift` moves the optimum of all of them, `fail_at` raises or gives NaN at the calls of these numbers.
    """

    shift: float = 0.0
    fail_at: dict[int, str] = field(default_factory=dict)
    calls: int = 0
    num_steps: int = 10

    def __call__(self, values):
        failure = self.fail_at.get(self.calls)
        self.calls += 1
        if failure == "raise":
            raise NumericalError("measurement covariance: not positive definite")
        misfit = sum(self._square(name, value) for name, value in values.items())
        return -misfit * torch.tensor([4.0, 6.0]) * (torch.nan if failure == "nan" else 1.0)

    def _square(self, name, value):
        unconstrained = torch.log if name == "birth_mean" else torch.logit
        optimum = unconstrained(torch.tensor(OPTIMUM[name], dtype=torch.float64)) + self.shift
        return (unconstrained(value) - optimum).square().sum()


@pytest.fixture
def quadratic():
    return Quadratic


@pytest.fixture
def make():
    def make(*names, **entries):
        """Hyperparameters that start at START, or as these settings say."""
        settings = {name: HyperparameterSettings(start=START[name]) for name in names or START}
        known = Model().all_quantities() | {"mismatch_share": MISMATCH_SHARE}
        quantities = {name: known[name]._replace(value=value) for name, value in START.items()}
        return Hyperparameters({**settings, **entries}, quantities)

    return make


@pytest.fixture
def optimum():
    return OPTIMUM
