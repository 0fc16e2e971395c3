"""One field per sequence of a batch."""

from collections.abc import Callable, Sequence
from typing import Self

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.core.errors import require
from torchdt.field.base import BaseField, Field, as_field


class StackedField(BaseField):
    """Applies the b-th field to the b-th element of a state's leading dimension.

    What only some of the fields know counts as nothing in the others: no diffuse part is one of zero.

    Args:
        fields: one per sequence, of equal numbers of tones, sensors and coordinates.

    Raises:
        InputError: where there is none, or these numbers differ.
    """

    def __init__(self, fields: Sequence[Field]):
        require(len(fields) > 0, "fields", "none", "one for each sequence")
        self.fields = tuple(map(as_field, fields))
        self.num_sequences, first = len(self.fields), self.fields[0]
        self.num_tones, self.num_sensors = first.num_tones, first.num_sensors
        self.num_coordinates = first.num_coordinates
        numbers = [(f.num_tones, f.num_sensors, f.num_coordinates) for f in self.fields]
        expected = "the same tones, sensors and coordinates for all sequences"
        require(len(set(numbers)) == 1, "fields", numbers, expected)

    def __call__(self, state: Tensor) -> Tensor:
        """Evaluate the responses, `(B, *batch, D)` to `(B, *batch, I, M)`."""
        return torch.stack([field(x) for field, x in self._each(state)])

    def inside(self, state: Tensor) -> Tensor | None:
        """Whether there can be an object, `(B, *batch, D)` to `(B, *batch)` bool; None: anywhere."""
        return _join([field.inside(x) for field, x in self._each(state)], torch.ones_like)

    def images(self, state: Tensor) -> Tensor:
        """Positions of equal responses, `(B, *batch, D)` to `(n, B, *batch, d)`."""
        found = [field.images(x) for field, x in self._each(state)]
        most = max(len(images) for images in found)
        ends = (0, 0) * (found[0].ndim - 1)
        return torch.stack([pad(i, (*ends, 0, most - len(i)), value=torch.nan) for i in found], 1)

    def diffuse(self, state: Tensor) -> Tensor | None:
        """Diffuse covariances, `(B, *batch, D)` to `(B, *batch, I, M, M)`."""
        return _join([field.diffuse(x) for field, x in self._each(state)], torch.zeros_like)

    def incoherent(self, state: Tensor) -> Tensor | None:
        """Covariances without phases, `(B, *batch, D)` to `(B, *batch, I, M, M)`, where all know them."""
        found = [field.incoherent(x) for field, x in self._each(state)]
        known = [part for part in found if part is not None]
        return torch.stack(known) if len(known) == len(found) else None

    def select(self, sequences: slice | Sequence[int]) -> Self:
        """The fields of some sequences; the same object where these are all."""
        chosen = range(len(self.fields))[sequences] if isinstance(sequences, slice) else sequences
        fields = tuple(self.fields[b] for b in chosen)
        return self if fields == self.fields else type(self)(fields)

    def _each(self, state: Tensor) -> Sequence[tuple[BaseField, Tensor]]:
        return list(zip(self.fields, state, strict=True))


def _join(parts: Sequence[Tensor | None], otherwise: Callable[[Tensor], Tensor]) -> Tensor | None:
    """One tensor of all parts, with something else for those that are None; None where all are."""
    known = [part for part in parts if part is not None]
    if not known:
        return None
    return torch.stack([otherwise(known[0]) if part is None else part for part in parts])
