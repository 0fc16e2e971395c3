"""Parts of the statistical model: what each declares of its numbers.

A part is a frozen dataclass. A number that a likelihood can be differentiated in is a field made by `number`,
and known by the field's name everywhere: in configurations, in Python, in tuning, in results. For example::

    @dataclass(frozen=True)
    class GammaPower(Part):
        power_shape: Number = number(1e4, SHAPE)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import torch
from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.core.support import Quantity, Support

if TYPE_CHECKING:
    from torchdt.model.region import Region

Number = Any
"""A float, or a real tensor of shape `()` or `(*batch,)` for a number of its own per sequence; of a vector, a
list of floats or a tensor `(d,)` or `(*batch, d)`."""


def number(default: float | Sequence[float] | None, support: Support, *, vector: bool = False) -> Any:
    """Declare a number of a part.

    Args:
        default: None where it comes from elsewhere, or where the part does without.
        support: where it lies.
        vector: whether it is one number for each coordinate.
    """
    return dataclasses.field(default=default, metadata={"support": support, "vector": vector})


def append_dims(value: Tensor, dims: int) -> Tensor:
    """Append dimensions of size one, so that `(*batch,)` broadcasts to `(*batch, ...)`."""
    return value.reshape((*value.shape, *(1 for _ in range(dims))))


@dataclass(frozen=True)
class Part:
    """Base of the parts of a model.

    Attributes:
        KEY: of the part in the configuration, for messages.
    """

    KEY: ClassVar[str] = "model"

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: naming the first that is not in its support.
        """
        optional = {f.name for f in dataclasses.fields(self) if f.default is None}
        for name, quantity in self.quantities().items():
            if not (name in optional and quantity.value is None):
                _check(f"{self.KEY}.{name}", quantity)

    def quantities(self) -> dict[str, Quantity]:
        """The numbers of this part by name, with their values."""
        return {
            f.name: Quantity(f.metadata["support"], getattr(self, f.name), f.metadata["vector"])
            for f in dataclasses.fields(self)
            if "support" in f.metadata
        }

    def with_numbers(self, values: Mapping[str, Tensor | float | Sequence[float]]) -> Self:
        """The same part with those of the values that are numbers of it; gradients pass."""
        known = self.quantities()
        own = {name: _like(known[name].value, value) for name, value in values.items() if name in known}
        return dataclasses.replace(self, **own) if own else self

    def on(self, region: Region) -> Self:
        """The same part with its numbers as tensors, in the type and on the device of a region."""
        like = region.low
        return dataclasses.replace(
            self,
            **{
                name: torch.as_tensor(q.value, dtype=like.dtype, device=like.device)
                for name, q in self.quantities().items()
                if q.value is not None
            },
        )

    def select(self, sequences: slice | list[int]) -> Self:
        """The part for some sequences of a batch `(B,)`; a number that all share stays as it is."""
        return self.with_numbers(
            {
                name: q.value[sequences]
                for name, q in self.quantities().items()
                if isinstance(q.value, Tensor) and q.value.ndim > q.vector
            }
        )


def _like(old: Any, value: Any) -> Any:
    fits = isinstance(old, Tensor) and value is not None
    return torch.as_tensor(value, dtype=old.dtype, device=old.device) if fits else value


def _check(key: str, quantity: Quantity) -> None:
    value: Any = quantity.value
    limits = quantity.support.range
    if isinstance(value, Tensor) and value.is_meta:  # no numbers to check
        return
    if isinstance(value, Tensor):
        found = [value.detach().min().item(), value.detach().max().item()]
    elif quantity.vector:
        if not isinstance(value, list | tuple):
            raise InputError.of_key(key, value, f"a list, each entry {limits.words}, or null")
        found = list(value)
    else:
        found = [value]
    for entry in found:
        fault = limits.fault(entry)
        require(fault is None, key, entry, fault)
