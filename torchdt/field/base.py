"""The array response `a(x)`, the only place where the physics of an array enters."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from torch import Tensor

from torchdt.core.errors import InputError, require

OPTIONAL = ("num_sequences", "inside", "images", "diffuse", "incoherent")
"""What `BaseField` has beside a call and `select`, and a field of one's own may have."""


@runtime_checkable
class Field(Protocol):
    """Response of a sensor array to a unit-amplitude object.

    A field is any callable with these attributes, for example a `torch.nn.Module`. It must be
    differentiable in the state where gradient-based methods are to use it. What else it knows it says with
    the methods of `BaseField`, inherited or not.

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
            state: `(*batch, D)` real: d positions, then d rates, which most fields do not read.

        Returns:
            `(*batch, I, M)` complex, in the complex type that belongs to the state's real type.
        """
        ...


class BaseField(Field):
    """A field with all that a tracker may ask of it; inherit from it, and override what yours knows.

    Attributes:
        num_sequences: number B of sequences that have a field each, for states `(B, *batch, D)`; None: one
            field serves all.
    """

    num_sequences: int | None = None

    def inside(self, state: Tensor) -> Tensor | None:
        """Whether there can be an object, `(*batch, D)` to `(*batch,)` bool; None: anywhere."""
        return None

    def images(self, state: Tensor) -> Tensor:
        """Positions that the array cannot tell from those of states: n of them, of equal responses.

        Args:
            state: `(*batch, D)`.

        Returns:
            `(n, *batch, d)`; NaN where there is none.
        """
        return state.new_empty(0, *state.shape[:-1], self.num_coordinates)

    def diffuse(self, state: Tensor) -> Tensor | None:
        """Covariance of the part that the response does not cover, `(*batch, D)` to `(*batch, I, M, M)`.

        None where the response covers all.
        """
        return None

    def incoherent(self, state: Tensor) -> Tensor | None:
        """Mean of `a a^H` with the phases of its parts lost, of trace `|a|^2`.

        `(*batch, D)` to `(*batch, I, M, M)` complex Hermitian; None where the field does not know it.
        """
        return None

    def select(self, sequences: slice | Sequence[int]) -> "BaseField":
        """The field for some sequences of a batch; the same object where these are all, or one serves all."""
        return self


class AdaptedField(BaseField):
    """A field of one's own with the methods that it lacks.

    Raises:
        InputError: where it is no `Field`.
    """

    def __init__(self, field: Field):
        if not isinstance(field, Field):
            raise InputError.of_key(
                "field", type(field).__name__, "an object that follows torchdt.field.Field"
            )
        for name in ("num_tones", "num_sensors", "num_coordinates"):
            number = getattr(field, name)
            require(isinstance(number, int) and number >= 1, f"field.{name}", number, "a positive integer")
        self.field = field
        self.num_tones, self.num_sensors = field.num_tones, field.num_sensors
        self.num_coordinates = field.num_coordinates
        for name in OPTIONAL:
            if hasattr(field, name):
                setattr(self, name, getattr(field, name))

    def __call__(self, state: Tensor) -> Tensor:
        """Evaluate the response, see `Field`."""
        return self.field(state)

    def select(self, sequences: slice | Sequence[int]) -> BaseField:
        """See `BaseField`."""
        chosen = self.field.select(sequences) if hasattr(self.field, "select") else self.field
        return self if chosen is self.field else as_field(chosen)


def as_field(field: Field) -> BaseField:
    """Any field with all that a tracker may ask of it; the same object where it has that.

    Raises:
        InputError: where it is no `Field`.
    """
    return field if isinstance(field, BaseField) else AdaptedField(field)


def repeat_field(field: BaseField, number: int) -> BaseField:
    """The field for a batch that is repeated as a whole: what all share stays as it is."""
    if field.num_sequences is None:
        return field
    return field.select([*range(field.num_sequences)] * number)


def of_each(field: BaseField, states: Tensor) -> Tensor:
    """States that all sequences share, as the field takes them: `(B, *batch, D)` where each has its own."""
    return states if field.num_sequences is None else states.expand(field.num_sequences, *states.shape)
