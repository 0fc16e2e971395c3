"""The array response `a(x)`, the only place where the physics of an array enters."""

from typing import Protocol, runtime_checkable

from torch import Tensor


@runtime_checkable
class Field(Protocol):
    """Response of a sensor array to a unit-amplitude object.

    A field is any callable with these attributes, for example a `torch.nn.Module`. It must be
    differentiable in the state where gradient-based methods are to use it.

    Attributes:
        num_tones: number of tones I.
        num_sensors: number of sensors M.
        num_coordinates: number d of position coordinates; a state is d positions, then d rates.
    """

    num_tones: int
    num_sensors: int
    num_coordinates: int

    def __call__(self, state: Tensor) -> Tensor:
        """Evaluate the response.

        Args:
            state: `(*batch, D)` real with `D >= num_coordinates`; only the leading
                `num_coordinates` entries (the position) are read.

        Returns:
            `(*batch, I, M)` complex, in the complex type that belongs to the state's real type.
        """
        ...


@runtime_checkable
class BoundedField(Field, Protocol):
    """A field that knows where objects cannot be, beside the limits of each coordinate."""

    def inside(self, state: Tensor) -> Tensor:
        """Whether there can be an object, `(*batch, D)` to `(*batch,)` bool."""
        ...
