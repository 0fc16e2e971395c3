"""Points that a detector finds in one or more steps of array data."""

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torchdt.model.measurement import Measurement


class Points(NamedTuple):
    """At most Q points per step, strongest first; the values of absent ones are finite but meaningless.

    Attributes:
        position: `(*batch, Q, d)`.
        strength: `(*batch, Q)` log-likelihood ratio of the point given the other ones, nats; >= 0.
        power: `(*batch, Q, I)` transmit power per tone, squared units of the measurement.
        present: `(*batch, Q)` bool.
        noise: `(*batch, I)` noise variance per tone, squared units of the measurement.
    """

    position: Tensor
    strength: Tensor
    power: Tensor
    present: Tensor
    noise: Tensor

    def strongest_first(self) -> "Points":
        """The same points by decreasing strength, absent ones last."""
        key = torch.where(self.present, self.strength, -torch.inf)
        order = key.argsort(dim=-1, descending=True, stable=True)

        def sort(values: Tensor) -> Tensor:
            return values.gather(-2, order[..., None].expand_as(values))

        return self._replace(
            position=sort(self.position),
            strength=self.strength.gather(-1, order),
            power=sort(self.power),
            present=self.present.gather(-1, order),
        )

    def above(self, threshold: float) -> "Points":
        """Only points of at least this strength, in nats."""
        return self._replace(present=self.present & (self.strength >= threshold))


class Detector(Protocol):
    """From array data to points."""

    def __call__(self, measurement: Measurement) -> Points:
        """Detect the points of every step, batch `(*batch,)` or `(B, K)` with a field per sequence."""
        ...
