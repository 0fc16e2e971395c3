"""Transmit powers: what a model of them must offer."""

from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

from torch import Tensor

from torchdt.model.part import append_dims
from torchdt.model.region import Region


class Switch(NamedTuple):
    """A Markov chain of two states: an object transmits, or is silent.

    Attributes:
        falls_silent: `(*batch,)` probability per step of the one that transmits.
        resumes: `(*batch,)` probability per step of the one that is silent.
    """

    falls_silent: Any
    resumes: Any

    def predict(self, transmits: Tensor) -> Tensor:
        """Probability of transmission one step later, `(*batch, ...)` like the one before."""
        falls, resumes = (append_dims(rate, transmits.ndim - rate.ndim) for rate in self)
        return transmits * (1 - falls) + (1 - transmits) * resumes


@runtime_checkable
class PowerModel(Protocol):
    """How the power of each tone of an object begins and changes; beliefs are weighted support points.

    All of batch `(*batch,)`, where a number of the model of shape `(*batch,)` stands for all that follows.
    """

    @property
    def switch(self) -> Switch | None:
        """How all tones of an object fall silent together and resume; None where they never do."""
        ...

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
