"""Particles as predicted, weighted by the likelihood (Gordon, Salmond and Smith 1993)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torchdt.core.importance import Box
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import Resampler
from torchdt.filter.bp.schedule import Beliefs, Schedule, update
from torchdt.filter.context import StepContext
from torchdt.filter.predict import Predicted
from torchdt.filter.proposal.base import NewbornDensity
from torchdt.filter.proposal.moved import Draws
from torchdt.filter.proposal.neighbourhood import cell_around
from torchdt.filter.slots import Placed
from torchdt.filter.state import Objects
from torchdt.model.motion.driving import Gradient
from torchdt.model.region import Region


@dataclass(frozen=True)
class AsPredicted:
    """Particles as predicted, new ones uniform in a cell, resampled after each step."""

    moves: ClassVar[bool] = False
    mixture_components: ClassVar[int] = 1

    @property
    def fit_size(self) -> tuple[int, int]:
        """Nothing is fitted."""
        return 0, 0

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
        """They stay where they are."""
        objects, response = predicted.objects, predicted.response
        first = update(
            objects,
            response,
            beliefs.noise,
            context.measurement,
            sweeps=1,
            schedule=schedule,
            initial=beliefs,
            noise_model=context.model.noise,
        )
        return Placed(objects, response, first)

    def refine(
        self, log_likelihood: Callable[[Tensor], Tensor], cell: Tensor, around: Box, rounds: Tensor
    ) -> Tensor:
        """The centre of the cell."""
        return cell

    def newborn(
        self, log_likelihood: Callable[[Tensor], Tensor], peak: Tensor, region: Region, rounds: Tensor
    ) -> NewbornDensity:
        """Uniform in one cell."""
        cell = cell_around(peak, region)
        return NewbornDensity(cell, cell, cell)

    def resample(self, objects: Objects, resampler: Resampler, streams: RandomStreams) -> Objects:
        """Equal weights where too few particles carry them."""
        draws = resampler.draw(streams, *objects.state.shape[-3:])
        state, log_weight = resampler.resample(objects.state, objects.log_weight, draws)
        return objects._replace(state=state, log_weight=log_weight)
