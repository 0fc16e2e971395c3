"""Quantities of the model that can be learned, each within its support, trainable or frozen."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.distributions import Normal

from torchdt.core.errors import InputError, require
from torchdt.core.support import POSITIVE, Quantity


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
        settings: by name.
        quantities: all that there are, by name: of a model, of a field. Their values are starts where the
            settings have none, and give the lengths of vectors.

    Raises:
        InputError: naming `hyperparameters.<name>`, where a name is unknown or has neither start nor value,
            or where a value lies outside the support or has the wrong length.
    """

    def __init__(self, settings: Mapping[str, HyperparameterSettings], quantities: Mapping[str, Quantity]):
        super().__init__()
        self.names = tuple(settings)
        self._quantities = {name: quantities[name] for name in settings if name in quantities}
        self._priors: dict[str, tuple[Tensor, float]] = {}
        for name, entry in settings.items():
            key = f"hyperparameters.{name}"
            require(name in quantities, key, "an unknown name", f"one of {sorted(quantities)}")
            quantity = quantities[name]
            tunable = quantity.value is not None or entry.start is not None
            require(tunable, key, "neither start nor default", "a quantity of this model; untunable here")
            default = None if quantity.value is None else _numbers(key, quantity.value)
            start = _numbers(key, entry.start) if default is None or entry.start is not None else default
            value = _checked(quantity, key, start, default, frozen=not entry.trainable)
            if not entry.trainable:
                self.register_buffer(f"frozen_{name}", value)
                continue
            support = quantity.support
            self.register_parameter(name, nn.Parameter(support.unconstrain(value)))
            if entry.prior is not None:
                key, spread = f"{key}.prior", entry.prior.spread
                require(0 < spread < math.inf, f"{key}.spread", spread, POSITIVE.words)
                median = _numbers(f"{key}.median", entry.prior.median)
                median = _checked(quantity, f"{key}.median", median, value, frozen=False)
                self._priors[name] = support.unconstrain(median), spread

    @property
    def trainable_names(self) -> tuple[str, ...]:
        """Names of the quantities that are learned, in the order of `parameters()`."""
        return tuple(name for name, _ in self.named_parameters())

    def forward(self) -> dict[str, Tensor]:
        """Values by name, float64, of shape `()`, or `(length,)` for vectors."""
        raw = dict(self.named_parameters())
        return {
            name: self._quantities[name].support.constrain(raw[name])
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


def _checked(quantity: Quantity, key: str, value: Tensor, like: Tensor | None, *, frozen: bool) -> Tensor:
    """Values inside their support, of the shape of `like` where that is known."""
    shape = value.shape if like is None else like.shape
    length = "" if like is None else f"{like.numel()} "
    expected = f"a list of {length}numbers" if quantity.vector else "one number"
    fits = len(shape) == int(quantity.vector) and 0 not in shape and value.shape in (shape, ())
    require(fits, key, f"shape {tuple(value.shape)}", expected)
    support = quantity.support
    for entry in value.flatten().tolist():
        fault = support.range.fault(entry)
        require(fault is None, key, value.tolist(), fault)
    require(frozen or support.inside(value), key, value.tolist(), f"{support.words}, or trainable: false")
    return value.expand(shape).clone()
