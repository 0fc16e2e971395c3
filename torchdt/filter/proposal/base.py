"""What a proposal decides: where the particles of a step are."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol, runtime_checkable

from torch import Tensor

from torchdt.core.importance import Box, Density
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import Resampler
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.schedule import Schedule
from torchdt.filter.context import StepContext
from torchdt.filter.slots import Placed
from torchdt.filter.state import Objects
from torchdt.model.motion.driving import Gradient
from torchdt.model.region import Region

if TYPE_CHECKING:
    from torchdt.filter.predict import Predicted
    from torchdt.filter.proposal.moved import Draws


class NewbornDensity(NamedTuple):
    """Where a new object may be, and where its particles are drawn.

    Attributes:
        prior: box that the object is born in.
        proposal: density of the particles, the box or what is fitted to the likelihood in it.
        places: where the pick sees its object, see `torchdt.filter.proposal.neighbourhood.drop_foreign`.
    """

    prior: Box
    proposal: Density
    places: Box


@runtime_checkable
class Proposal(Protocol):
    """Where the particles of a step are.

    Attributes:
        moves: whether known objects move to the data. Of their predictions the density then suffices, and
            once new objects are found, whose energy has pulled at them, they are placed again.
    """

    moves: ClassVar[bool]

    @property
    def mixture_components(self) -> int:
        """Number of Gaussians, at most, that an object is predicted by."""
        ...

    @property
    def fit_size(self) -> tuple[int, int]:
        """Number of rounds in which densities are fitted, and the sample size of each."""
        ...

    def place_known(
        self,
        context: StepContext,
        predicted: Predicted,
        beliefs: Beliefs,
        draws: Draws,
        extra_signal: Tensor | None,
        schedule: Schedule,
        gradient: Gradient,
    ) -> Placed:
        """Known objects on the particles of this step, after one sweep over them.

        Args:
            context: field, region, model and data.
            predicted: known objects before the data, batch `(*batch, N)`.
            beliefs: about them, and about the noise.
            draws: random numbers.
            extra_signal: `(*batch, I, M, M)` covariance of signals that are no objects yet.
            schedule: order of the messages, where all are computed on the same particles.
            gradient: how particles depend on the prediction.
        """
        ...

    def refine(
        self, log_likelihood: Callable[[Tensor], Tensor], cell: Tensor, around: Box, rounds: Tensor
    ) -> Tensor:
        """Position of a new object, `(*batch, d)`.

        Args:
            log_likelihood: maps positions `(*batch, S, d)` to `(*batch, S)`.
            cell: `(*batch, d)` centre of the cell that was picked.
            around: box around it that holds the peak.
            rounds: `(rounds, *batch, S, d)` standard normal draws.
        """
        ...

    def newborn(
        self, log_likelihood: Callable[[Tensor], Tensor], peak: Tensor, region: Region, rounds: Tensor
    ) -> NewbornDensity:
        """Densities of new objects.

        Args:
            log_likelihood: maps positions `(*batch, S, d)` to `(*batch, S)`.
            peak: `(*batch, d)` the refined positions.
            region: region of interest.
            rounds: `(rounds, *batch, S, d)` standard normal draws.
        """
        ...

    def resample(self, objects: Objects, resampler: Resampler, streams: RandomStreams) -> Objects:
        """Objects as the next step finds them."""
        ...
