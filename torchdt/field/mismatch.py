"""Responses that are known only in part.

The response of an object is `sqrt(1 - eps)` times the modelled one plus a random part of covariance
`eps R(x)`, eps per tone. With mode phases off by independent normal errors of variance `v`, the mean of
`a a^H` is `exp(-v) a a^H + (1 - exp(-v)) R(x)`, where R(x) adds the modes up without their phases: so
`eps = 1 - exp(-v)`, and nothing else is needed to know R.
"""

from typing import Protocol, runtime_checkable

from torch import Tensor

from torchdt.field.base import Field


@runtime_checkable
class DiffuseField(Field, Protocol):
    """A field that also says how its response scatters around the model."""

    def diffuse(self, state: Tensor) -> Tensor:
        """Covariance of the part that the response does not cover, `(*batch, D)` to `(*batch, I, M, M)`."""
        ...


@runtime_checkable
class IncoherentField(Field, Protocol):
    """A field that knows its response with the phases of its parts lost."""

    def incoherent(self, state: Tensor) -> Tensor:
        """`R(x)`, of trace `|a(x)|^2`, `(*batch, D)` to `(*batch, I, M, M)` complex Hermitian."""
        ...


class MismatchedField:
    """A field of which a share of each tone's energy is not where the model says.

    Args:
        field: the modelled response.
        share: eps, `(I,)` real in [0, 1).
    """

    def __init__(self, field: IncoherentField, share: Tensor):
        self.field, self.share = field, share
        self.num_tones, self.num_sensors = field.num_tones, field.num_sensors
        self.num_coordinates = field.num_coordinates

    def __call__(self, state: Tensor) -> Tensor:
        """The coherent part, `sqrt(1 - eps) a(x)`, `(*batch, D)` to `(*batch, I, M)`."""
        return self.field(state) * (1 - self.share).sqrt()[:, None]

    def diffuse(self, state: Tensor) -> Tensor:
        """`eps R(x)`, `(*batch, D)` to `(*batch, I, M, M)`."""
        return self.field.incoherent(state) * self.share[:, None, None]
