"""One field per sequence of a batch."""

from collections.abc import Sequence
from typing import Self

import torch
from torch import Tensor

from torchdt.field.base import Field
from torchdt.field.mismatch import DiffuseField


class StackedField:
    """Applies the b-th field to the b-th element of a state's leading dimension.

    Args:
        fields: one per sequence, of equal numbers of tones, sensors and coordinates.
    """

    def __init__(self, fields: Sequence[Field]):
        self.fields = tuple(fields)
        self.num_tones = self.fields[0].num_tones
        self.num_sensors = self.fields[0].num_sensors
        self.num_coordinates = self.fields[0].num_coordinates

    def __call__(self, state: Tensor) -> Tensor:
        """Evaluate the responses, `(B, *batch, D)` to `(B, *batch, I, M)`."""
        return torch.stack([field(x) for field, x in zip(self.fields, state, strict=True)])

    def select(self, sequences: slice | Sequence[int]) -> Self:
        """The fields of some sequences; the same object where these are all."""
        chosen = range(len(self.fields))[sequences] if isinstance(sequences, slice) else sequences
        fields = tuple(self.fields[b] for b in chosen)
        return self if fields == self.fields else type(self)(fields)


class StackedDiffuseField(StackedField):
    """The same for fields that say how their responses scatter."""

    fields: tuple[DiffuseField, ...]

    def diffuse(self, state: Tensor) -> Tensor:
        """Diffuse covariances, `(B, *batch, D)` to `(B, *batch, I, M, M)`."""
        return torch.stack([field.diffuse(x) for field, x in zip(self.fields, state, strict=True)])


def select_field(field: Field, sequences: slice | Sequence[int]) -> Field:
    """The field for some sequences of a batch: what all share stays as it is."""
    return field.select(sequences) if isinstance(field, StackedField) else field


def repeat_field(field: Field, number: int) -> Field:
    """The field for a batch that is repeated as a whole: what all share stays as it is."""
    return type(field)(field.fields * number) if isinstance(field, StackedField) else field
