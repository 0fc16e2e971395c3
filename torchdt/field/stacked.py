"""One field per sequence of a batch."""

from collections.abc import Sequence

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


class StackedDiffuseField(StackedField):
    """The same for fields that say how their responses scatter."""

    fields: tuple[DiffuseField, ...]

    def diffuse(self, state: Tensor) -> Tensor:
        """Diffuse covariances, `(B, *batch, D)` to `(B, *batch, I, M, M)`."""
        return torch.stack([field.diffuse(x) for field, x in zip(self.fields, state, strict=True)])
