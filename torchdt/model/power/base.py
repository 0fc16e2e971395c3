"""Transmit powers: what a model of them must offer."""

from typing import Protocol, Self, runtime_checkable

from torch import Tensor

from torchdt.model.region import Region


@runtime_checkable
class PowerModel(Protocol):
    """How the power of each tone of an object begins and changes; beliefs are weighted support points.

    All of batch `(*batch,)`, where a number of the model of shape `(*batch,)` stands for all that follows.
    """

    def initial(self, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """Support points and log-weights `(*batch, G)` before anything is known.

        Args:
            maximum: `(*batch,)` largest power of the prior.
            num_points: G.
        """
        ...

    def newborn(self, scale: Tensor, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The same for a new object whose likelihood lies at about `scale`, `(*batch,)`."""
        ...

    def predict(self, power: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
        """Support points and log-weights `(*batch, G)` one step later.

        Args:
            power: `(*batch, G)` positive support points.
            log_weight: `(*batch, G)` normalised.
        """
        ...

    def level_transition(self, level: Tensor) -> Tensor:
        """Probability of the levels of one step after those of the last, `(*batch, L, L')`.

        Args:
            level: `(L,)` powers in relation to one another, evenly spaced in the logarithm.
        """
        ...

    def on(self, region: Region) -> Self:
        """The model with numbers in the type and on the device of a region."""
        ...

    def select(self, sequences: slice | list[int]) -> Self:
        """The model of some sequences of a batch."""
        ...
