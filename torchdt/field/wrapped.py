"""Fields around other fields: all that is not changed is forwarded."""

from collections.abc import Callable, Sequence
from typing import Self

from torch import Tensor

from torchdt.field.base import BaseField, Field, as_field


class WrappedField(BaseField):
    """What a field says, to be changed in part by a subclass.

    Args:
        field: the one inside.
    """

    def __init__(self, field: Field):
        self.field = as_field(field)
        self.num_tones, self.num_sensors = self.field.num_tones, self.field.num_sensors
        self.num_coordinates, self.num_sequences = self.field.num_coordinates, self.field.num_sequences

    def around(self, field: BaseField) -> Self:
        """The same around another field."""
        return type(self)(field)

    def at(self, state: Tensor) -> Tensor:
        """The states at which the field inside is asked."""
        return state

    def __call__(self, state: Tensor) -> Tensor:
        """Evaluate the response, see `Field`."""
        return self.field(self.at(state))

    def inside(self, state: Tensor) -> Tensor | None:
        """See `BaseField`."""
        return self.field.inside(self.at(state))

    def images(self, state: Tensor) -> Tensor:
        """See `BaseField`."""
        return self.field.images(self.at(state))

    def diffuse(self, state: Tensor) -> Tensor | None:
        """See `BaseField`."""
        return self.field.diffuse(self.at(state))

    def incoherent(self, state: Tensor) -> Tensor | None:
        """See `BaseField`."""
        return self.field.incoherent(self.at(state))

    def select(self, sequences: slice | Sequence[int]) -> Self:
        """See `BaseField`."""
        chosen = self.field.select(sequences)
        return self if chosen is self.field else self.around(chosen)


class CompletedField(WrappedField):
    """A field that takes positions without rates as well.

    Searches look at positions alone; a field whose response depends on the rates is told likely ones.

    Args:
        field: takes whole states.
        complete: maps positions `(*batch, d)` to states `(*batch, 2 d)`, and states to themselves.
    """

    def __init__(self, field: Field, complete: Callable[[Tensor], Tensor]):
        super().__init__(field.field if isinstance(field, CompletedField) else field)
        self.complete = complete

    def around(self, field: BaseField) -> Self:
        """The same around another field."""
        return type(self)(field, self.complete)

    def at(self, state: Tensor) -> Tensor:
        """Whole states."""
        return self.complete(state)
