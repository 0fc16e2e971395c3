"""Evidence of one time step, `log p(z_k | z_1..k-1)`, given the predicted beliefs of objects and noise.

Two estimates. The Gaussian one replaces the predicted mixture by one Gaussian of the same covariance: one
factorisation, and it knows nothing of new objects. The sampled one weights joint configurations, drawn from
the posterior beliefs, by exact likelihood times prior over proposal: unbiased for p (not for its logarithm)
whatever the beliefs are, and of low variance where BP comes near the truth.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.core.linalg import check_finite
from torchdt.core.random import RandomStreams
from torchdt.core.ranges import Checked, Count
from torchdt.filter.bp.beliefs import Beliefs, as_belief
from torchdt.filter.bp.configurations import (
    Configurations,
    UniformDraws,
    draw_configurations,
    labellings,
    log_probability,
)
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.context import StepContext
from torchdt.filter.predict import Predicted, exchangeable
from torchdt.filter.slots import Placed
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.noise.base import Noise, NoiseCovariance
from torchdt.model.noise.white import WHITE


@runtime_checkable
class Evidence(Protocol):
    """An estimate of `log p(z_k | z_1..k-1)`.

    Attributes:
        every_response: whether it asks the field for all particles of the predicted objects, not for some.
        knows_births: whether new objects are part of it; what is not looked at then adds to it.
    """

    every_response: ClassVar[bool]
    knows_births: ClassVar[bool]

    def draw(self, streams: RandomStreams, slots: int, births: int, num_tones: int) -> Any:
        """Random numbers of one step, always as many."""
        ...

    def estimate(
        self,
        context: StepContext,
        predicted: Predicted,
        current: Placed,
        beliefs: Beliefs,
        draws: Any,
    ) -> Tensor:
        """The evidence of a step, `(*batch,)`.

        Args:
            context: field, region, model and data; the likelihood is not tempered.
            predicted: known objects and noise before the data, batch `(*batch, N)`.
            current: known and new objects on the particles of this step.
            beliefs: posterior beliefs about the current objects.
            draws: see `draw`.
        """
        ...


@dataclass(frozen=True)
class GaussianEvidence:
    """The predicted mixture as one Gaussian: cheap, crude, blind to new objects."""

    every_response: ClassVar[bool] = True
    knows_births: ClassVar[bool] = False

    def draw(self, streams: RandomStreams, slots: int, births: int, num_tones: int) -> None:
        """It needs none."""

    def estimate(
        self,
        context: StepContext,
        predicted: Predicted,
        current: Placed,
        beliefs: Beliefs,
        draws: None,
    ) -> Tensor:
        """See `gaussian_evidence`."""
        return gaussian_evidence(predicted.beliefs, context.measurement, context.noise)


@dataclass(frozen=True)
class SampledEvidence(Checked):
    """Importance sampling of joint configurations, drawn from the posterior beliefs.

    Attributes:
        samples: configurations of each step.
    """

    KEY: ClassVar[str] = "tracker.evidence"
    every_response: ClassVar[bool] = False
    knows_births: ClassVar[bool] = True

    samples: Count = 64

    def draw(
        self, streams: RandomStreams, slots: int, births: int, num_tones: int
    ) -> tuple[UniformDraws, int]:
        """Uniform draws for known and new objects, and the number of slots of known ones."""
        return UniformDraws.draw(streams, slots + births, num_tones, self.samples), slots

    def estimate(
        self,
        context: StepContext,
        predicted: Predicted,
        current: Placed,
        beliefs: Beliefs,
        draws: tuple[UniformDraws, int],
    ) -> Tensor:
        """See `sampled_evidence`."""
        (uniform, slots), region, noise = draws, context.region, context.noise
        known = predicted.objects.log_odds.shape[-1]
        new_odds = current.objects.log_odds[..., known:]
        # New objects are born in places of their own, and change them with no other.
        pairs = pad(exchangeable(predicted, region), (0, new_odds.shape[-1]) * 2)
        at = current.objects, current.response
        components = labellings(*at, context.measurement, beliefs, pairs, noise)
        chosen = uniform.pick(known, slots, new_odds.shape[-1])
        drawn = draw_configurations(*components, beliefs.noise, chosen)
        seen = predicted.beliefs.noise, context.measurement
        return sampled_evidence(*at, *seen, drawn, beliefs.diffuse, noise)


def gaussian_evidence(
    beliefs: Beliefs, measurement: Measurement, noise_model: NoiseCovariance = WHITE
) -> Tensor:
    """`log CN(z; 0, sum_n r_n E[gamma] E[a a^H] + E[eta] I)` under predicted beliefs, `(*batch,)`.

    Instead of `eta I` stands what the noise model makes of it.
    """
    signal = signal_covariance(beliefs.strength, beliefs.moment)
    covariance = noise_model.covariance(signal, beliefs.noise.mean, measurement.present)
    return gaussian_log_likelihood(measurement, covariance).sum(-1)


def sampled_evidence(
    prior: Objects,
    response: Tensor,
    noise: Noise,
    measurement: Measurement,
    configurations: Configurations,
    diffuse: Tensor | None = None,
    noise_model: NoiseCovariance = WHITE,
) -> Tensor:
    """`log mean_s f(z | c_s) p(c_s) / q(c_s)` over configurations `c_s ~ q`, `(*batch,)`.

    Gradients flow through likelihood and prior; the proposal is a constant.

    Args:
        prior: predicted objects, batch `(*batch, N)`; weights of the states need not be normalised.
        response: `(*batch, N, I, P, M)` complex responses of their particles; zero of silent ones.
        noise: predicted noise.
        measurement: statistics of the step, batch `(*batch,)`.
        configurations: S draws on the same support points.
        diffuse: `(*batch, N, I, M, M)` complex covariance, per unit power, of what the objects send beside
            their responses; None where the model is exact.
        noise_model: what the noise makes of the covariance of the data.

    Raises:
        NumericalError: where a covariance is not positive definite or the result not finite.
    """
    exists, state, power_index, level, log_proposal = configurations
    power = prior.power.gather(-1, power_index)
    amplitude = exists.unsqueeze(-2) * power.sqrt()  # (*batch, N, I, S)
    particle = state[..., None, :, None].expand(*power.shape, response.shape[-1])
    columns = response.gather(-2, particle).to(torch.complex128) * amplitude[..., None]
    columns = columns.movedim((-4, -2), (-1, -4))  # (*batch, S, I, M, N)
    per_sample = measurement._replace(factor=measurement.factor.to(columns.dtype)).unsqueeze()
    variance = noise.variance.gather(-1, level).movedim(-1, -2)
    if diffuse is None:
        log_likelihood = noise_model.log_likelihood(per_sample, columns, variance)
    else:
        sent = exists * prior.transmits.gather(-1, state)
        weights = (sent.unsqueeze(-2) * power).movedim(-3, -1).to(columns.dtype)  # (*batch, I, S, N)
        flat = diffuse.movedim(-4, -3).flatten(-2).to(columns.dtype)  # (*batch, I, N, M M)
        signal = columns @ columns.mH + (weights @ flat).unflatten(-1, diffuse.shape[-2:]).movedim(-4, -3)
        covariance = noise_model.covariance(signal, variance, per_sample.present)
        log_likelihood = gaussian_log_likelihood(per_sample, covariance)
    log_weight = (
        log_likelihood.sum(-1)
        + log_probability(as_belief(prior), exists, state, power_index)
        + noise.log_weight.gather(-1, level).sum(-2)
        - log_proposal
    )
    log_mean = torch.logsumexp(log_weight, -1) - math.log(log_weight.shape[-1])
    return check_finite(log_mean, "evidence").to(noise.variance.dtype)
