"""Particles where prediction and likelihood meet."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from torchdt.core.importance import Box, adapt
from torchdt.core.random import RandomStreams
from torchdt.core.ranges import Checked, Count, Passes
from torchdt.core.resampling import Resampler
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.schedule import Schedule
from torchdt.filter.context import StepContext
from torchdt.filter.predict import Predicted
from torchdt.filter.proposal.base import NewbornDensity
from torchdt.filter.proposal.moved import Draws, propose_adapted
from torchdt.filter.proposal.neighbourhood import grow, place_of
from torchdt.filter.slots import Placed
from torchdt.filter.state import Objects
from torchdt.model.motion.driving import Gradient
from torchdt.model.region import Region


@dataclass(frozen=True)
class Adapted(Checked):
    """Fitted to the likelihood; new particles in every step, which need no resampling.

    Attributes:
        mixture_components: Gaussians, at most, by which an object is predicted: one for each cluster of its
            particles. 1: one of the mean and covariance of them all, an assumed density.
        rounds: rounds of fitting, at most.
        round_size: sample size of each round.
    """

    KEY: ClassVar[str] = "tracker.proposal"
    moves: ClassVar[bool] = True

    mixture_components: Count = 4
    rounds: Passes = 6
    round_size: Count = 128

    @property
    def fit_size(self) -> tuple[int, int]:
        """See `Proposal.fit_size`."""
        return self.rounds, self.round_size

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
        """One object after another, see `propose_adapted`."""
        placed = propose_adapted(
            context.field,
            context.region,
            predicted.objects,
            predicted.density,
            beliefs,
            context.measurement,
            draws,
            extra_signal,
            gradient=gradient,
            noise_model=context.noise,
            silent=predicted.silent,
        )
        return Placed(*placed)

    def refine(
        self, log_likelihood: Callable[[Tensor], Tensor], cell: Tensor, around: Box, rounds: Tensor
    ) -> Tensor:
        """The peak of the likelihood between the points of the grid."""
        return adapt(log_likelihood, around, rounds)[0].fitted.mean

    def newborn(
        self, log_likelihood: Callable[[Tensor], Tensor], peak: Tensor, region: Region, rounds: Tensor
    ) -> NewbornDensity:
        """Uniform in a box that holds the likelihood, which is drawn from."""
        prior = grow(log_likelihood, peak, region, rounds)
        mixture = adapt(log_likelihood, prior, rounds)[0]
        return NewbornDensity(prior, mixture, place_of(mixture.fitted, prior))

    def resample(self, objects: Objects, resampler: Resampler, streams: RandomStreams) -> Objects:
        """The next step draws particles of its own."""
        return objects
