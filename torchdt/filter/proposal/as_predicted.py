"""Particles as predicted, weighted by the likelihood (Gordon, Salmond and Smith 1993)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.core.importance import Box
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import Resampler
from torchdt.filter.bp.beliefs import Beliefs, as_belief
from torchdt.filter.bp.schedule import Schedule
from torchdt.filter.bp.update import update
from torchdt.filter.context import StepContext
from torchdt.filter.predict import Predicted
from torchdt.filter.proposal.base import NewbornDensity
from torchdt.filter.proposal.moved import Draws, sent
from torchdt.filter.proposal.neighbourhood import cell_around
from torchdt.filter.slots import Placed
from torchdt.filter.state import Objects
from torchdt.model.motion.driving import Gradient
from torchdt.model.region import Region

DOUBT = 0.1
"""Share of the particles that are drawn to transmit, and to be silent, at least."""


def decide(objects: Objects, uniform: Tensor) -> Objects:
    """Particles that transmit or do not, drawn with their probabilities; weights make up for `DOUBT`.

    Args:
        objects: as predicted, batch `(*batch, N)`.
        uniform: `(*batch, N, P)` draws on [0, 1).
    """
    probability = objects.transmits
    drawn = probability.detach().clamp(DOUBT, 1 - DOUBT)
    transmits = uniform < drawn
    log_ratio = torch.where(transmits, probability / drawn, (1 - probability) / (1 - drawn)).log()
    log_weight = objects.log_weight + log_ratio
    return objects._replace(log_weight=log_weight, transmits=transmits.to(log_weight))


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
        """They stay where they are; of those of an object that may be silent some are, see `decide`."""
        objects = predicted.objects
        if context.model.power.switch is not None:
            uniform = torch.special.ndtr(draws.final[..., : objects.log_odds.shape[-1], :, 0])
            objects = decide(objects, uniform)
        response = sent(predicted.response, objects.transmits)
        first = update(
            objects,
            response,
            beliefs.noise,
            context.measurement,
            sweeps=1,
            schedule=schedule,
            initial=beliefs._replace(objects=as_belief(objects)),
            noise_model=context.noise,
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
        # Whether it transmits is of a particle like its state; what roughens moves it to neither side.
        both = torch.cat([objects.state, objects.transmits[..., None]], -1)
        draws = draws._replace(jitter=pad(draws.jitter, (0, 1)))
        state, log_weight = resampler.resample(both, objects.log_weight, draws)
        transmits = (state[..., -1] > 0.5).to(log_weight)
        return objects._replace(state=state[..., :-1], log_weight=log_weight, transmits=transmits)
