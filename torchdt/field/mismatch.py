"""Responses that are known only in part.

The response of an object is `sqrt(1 - eps)` times the modelled one plus a random part of covariance
`eps R(x)`, eps per tone. With mode phases off by independent normal errors of variance `v`, the mean of
`a a^H` is `exp(-v) a a^H + (1 - exp(-v)) R(x)`, where R(x) adds the modes up without their phases: so
`eps = 1 - exp(-v)`, and nothing else is needed to know R.
"""

from collections.abc import Sequence
from typing import Self

from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.core.support import UNIT, Quantity
from torchdt.field.base import BaseField, Field
from torchdt.field.wrapped import WrappedField

MISMATCH_SHARE = Quantity(UNIT, vector=True)
"""One for each tone; what a likelihood can be differentiated in."""


class MismatchedField(WrappedField):
    """A field of which a share of each tone's energy is not where the model says.

    Args:
        field: the modelled response, which knows itself without phases (`BaseField.incoherent`).
        share: eps, `(I,)` real in [0, 1).
    """

    def __init__(self, field: Field, share: Tensor):
        super().__init__(field)
        self.share = share

    def around(self, field: BaseField) -> Self:
        """The same share of another field."""
        return type(self)(field, self.share)

    def __call__(self, state: Tensor) -> Tensor:
        """The coherent part, `sqrt(1 - eps) a(x)`, `(*batch, D)` to `(*batch, I, M)`."""
        return self.field(state) * (1 - self.share).sqrt()[:, None]

    def diffuse(self, state: Tensor) -> Tensor:
        """`eps R(x)`, `(*batch, D)` to `(*batch, I, M, M)`.

        Raises:
            InputError: where the field does not know `R(x)`.
        """
        scattered = self.field.incoherent(state)
        if scattered is None:
            raise InputError.of_key("field", type(self.field).__name__, "one that knows how it scatters")
        return scattered * self.share[:, None, None]


def with_share(field: BaseField, share: Sequence[float], state: Tensor) -> MismatchedField:
    """A field of which a configured share of each tone is not where it says.

    Args:
        field: the modelled response.
        share: eps of each tone.
        state: any state that the field takes.

    Raises:
        InputError: naming `tracker.mismatch_share`, where the field has a share already or does not know how
            it scatters, or there is not one share for each tone.
    """
    key = "tracker.mismatch_share"
    require(field.diffuse(state) is None, key, share, "null: the field has a share of its own")
    knows = field.incoherent(state) is not None
    require(knows, key, share, "null: this field does not know how its response scatters")
    require(len(share) == field.num_tones, key, share, f"{field.num_tones} numbers, one for each tone")
    return MismatchedField(field, state.new_tensor(share))
