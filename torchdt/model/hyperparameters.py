"""Quantities of the model that can be learned, each within its support, trainable or frozen."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.distributions import Normal, biject_to, constraints

from torchdt.core.errors import InputError, require
from torchdt.model.gamma_chain import LEAST_SHAPE


class Support(NamedTuple):
    """Open interval in which a quantity lies.

    Attributes:
        constraint: whose bijection from the real line makes the quantity of its unconstrained value.
        low, high: ends of the interval.
        words: what lies inside, for error messages.
        frozen_at_high: whether a frozen quantity may lie at the upper end.
    """

    constraint: constraints.Constraint
    low: float
    high: float
    words: str
    frozen_at_high: bool = False


REAL = Support(constraints.real, -math.inf, math.inf, "finite")
POSITIVE = Support(constraints.positive, 0.0, math.inf, "positive and finite")
SHAPE = Support(
    constraints.greater_than(LEAST_SHAPE), LEAST_SHAPE, math.inf, f"above {LEAST_SHAPE:g} and finite"
)
UNIT = Support(constraints.unit_interval, 0.0, 1.0, "strictly between 0 and 1")
UP_TO_ONE = UNIT._replace(
    words=f"{UNIT.words}: start below 1, or freeze it at 1 (trainable: false)", frozen_at_high=True
)

SUPPORTS = {
    "power_shape": SHAPE,
    "noise_shape": SHAPE,
    "birth_mean": POSITIVE,
    "driving_variance": POSITIVE,
    "survival": UNIT,
    "mismatch_share": UNIT,
    "likelihood_power": UP_TO_ONE,
    "effective_count": POSITIVE,
    "eof_coefficients": REAL,
    "tilt_deg": REAL,
    "water_depth_m": REAL,
}
"""Known quantities; the last three are changes of the environment from the nominal one."""

VECTORS = ("driving_variance", "mismatch_share", "eof_coefficients")
"""One number for each coordinate `(d,)`, tone `(I,)` and EOF; all others are scalars."""


@dataclass
class PriorSettings:
    """Normal prior on the unconstrained value.

    Attributes:
        median: of the quantity itself, in its unit; a number, or a list for a vector.
        spread: standard deviation of the unconstrained value: the logarithm of a positive quantity, or of
            what a shape is above 1; the log-odds of one between 0 and 1; a real quantity itself.
    """

    median: Any
    spread: float


@dataclass
class HyperparameterSettings:
    """How one quantity is treated.

    Attributes:
        trainable: learn it; else keep it where it starts.
        start: a number, or a list for a vector (one number stands for all of them); None takes the default.
        prior: counts where the quantity is trainable.
    """

    trainable: bool = True
    start: Any = None
    prior: PriorSettings | None = None


class Hyperparameters(nn.Module):
    """Constrained quantities, held as unconstrained float64 parameters under their own names.

    The maps are those of `torch.distributions.biject_to`: exponential for positive quantities and for what
    shapes are above 1, logistic for those between 0 and 1. A frozen quantity is the buffer `frozen_<name>` of
    the value itself: it stays exact, and a state of other settings does not load unnoticed. All is made on
    the CPU; move it with `to`.

    Args:
        settings: by name, see `SUPPORTS`.
        defaults: what the model would use otherwise, by name: starts where the settings have none, and
            lengths of vectors.

    Raises:
        InputError: naming `hyperparameters.<name>`, where a name is unknown or has neither start nor
            default, or where a value lies outside the support or has the wrong length.
    """

    def __init__(
        self, settings: Mapping[str, HyperparameterSettings], defaults: Mapping[str, Tensor | float]
    ):
        super().__init__()
        self.names = tuple(settings)
        self._priors: dict[str, tuple[Tensor, float]] = {}
        for name, entry in settings.items():
            key = f"hyperparameters.{name}"
            require(name in SUPPORTS, key, "an unknown name", f"one of {sorted(SUPPORTS)}")
            tunable = name in defaults or entry.start is not None
            require(tunable, key, "neither start nor default", "a quantity of this model; untunable here")
            default = _numbers(key, defaults[name]) if name in defaults else None
            start = _numbers(key, entry.start) if default is None or entry.start is not None else default
            value = _checked(name, key, start, default, frozen=not entry.trainable)
            if not entry.trainable:
                self.register_buffer(f"frozen_{name}", value)
                continue
            to_support = biject_to(SUPPORTS[name].constraint)
            self.register_parameter(name, nn.Parameter(to_support.inv(value)))
            if entry.prior is not None:
                key, spread = f"{key}.prior", entry.prior.spread
                require(0 < spread < math.inf, f"{key}.spread", spread, f"a number {POSITIVE.words}")
                median = _numbers(f"{key}.median", entry.prior.median)
                median = _checked(name, f"{key}.median", median, value, frozen=False)
                self._priors[name] = to_support.inv(median), spread

    @property
    def trainable_names(self) -> tuple[str, ...]:
        """Names of the quantities that are learned, in the order of `parameters()`."""
        return tuple(name for name, _ in self.named_parameters())

    def forward(self) -> dict[str, Tensor]:
        """Values by name, float64, of shape `()`, or `(length,)` for those in `VECTORS`."""
        raw = dict(self.named_parameters())
        return {
            name: biject_to(SUPPORTS[name].constraint)(raw[name])
            if name in raw
            else self.get_buffer(f"frozen_{name}")
            for name in self.names
        }

    def log_prior(self) -> Tensor:
        """Log-density of the unconstrained trainable values, a scalar; 0 without priors."""
        raw = dict(self.named_parameters())
        terms = [
            Normal(mean.to(raw[name]), spread).log_prob(raw[name]).sum()
            for name, (mean, spread) in self._priors.items()
        ]
        return torch.stack(terms).sum() if terms else torch.zeros((), dtype=torch.float64)

    def values(self) -> dict[str, float | list[float]]:
        """Values as plain numbers, fit to be starts of other settings."""
        with torch.no_grad():
            return {name: value.tolist() for name, value in self().items()}


def _numbers(key: str, value: Any) -> Tensor:
    """A float64 tensor of its own."""
    try:
        return torch.as_tensor(value, dtype=torch.float64, device="cpu").detach().clone()
    except (TypeError, ValueError, RuntimeError):
        raise InputError.of_key(key, repr(value), "a number or a list of numbers") from None


def _checked(name: str, key: str, value: Tensor, like: Tensor | None, *, frozen: bool) -> Tensor:
    """Values inside their support, of the shape of `like` where that is known."""
    shape = value.shape if like is None else like.shape
    length = "" if like is None else f"{like.numel()} "
    expected = f"a list of {length}numbers" if name in VECTORS else "one number"
    fits = len(shape) == int(name in VECTORS) and 0 not in shape and value.shape in (shape, ())
    require(fits, key, f"shape {tuple(value.shape)}", expected)
    support = SUPPORTS[name]
    inside = (support.low < value) & (value < support.high)
    if frozen and support.frozen_at_high:
        inside = inside | (value == support.high)
    require(bool(inside.all()), key, value.tolist(), support.words)
    return value.expand(shape).clone()
