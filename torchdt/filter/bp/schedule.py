"""The order in which messages are computed decides whether loopy BP succeeds.

`Sequential` visits the objects one after another, strongest (existence x power) first, per batch
element; each visit uses the newest beliefs of the others. `Flooding` computes all messages at once from
the beliefs of the last pass, as loopy BP is usually written; it finds ghosts beside strong sources and
may oscillate for ever where objects overlap.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.trees import put, take, tree_map
from torchdt.core.weights import weighted_mean
from torchdt.filter.bp.messages import ObjectBelief, object_belief
from torchdt.filter.bp.moments import (
    response_moment,
    signal_covariance,
    signal_without_each,
    weighted_moment,
    without,
)
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseModel
from torchdt.model.noise.white import WHITE


class Beliefs(NamedTuple):
    """Current beliefs of all objects and the noise on fixed support points.

    Attributes:
        objects: `ObjectBelief` of batch `(*batch, N)`.
        noise: noise belief.
        moment: `(*batch, N, I, M, M)` complex `E[a a^H]`, diffuse part included.
        strength: `(*batch, N, I)` real `r E[gamma]`.
        power: `(*batch, N, I)` real `E[gamma]` given existence.
        diffuse: `(*batch, N, I, M, M)` complex covariance, per unit power, of what an object sends beside
            its modelled response; None where the model is exact.
    """

    objects: ObjectBelief
    noise: Noise
    moment: Tensor
    strength: Tensor
    power: Tensor
    diffuse: Tensor | None = None


def as_belief(objects: Objects) -> ObjectBelief:
    """The weights of potential objects, without their support points."""
    return ObjectBelief(objects.log_weight, objects.log_power_weight, objects.log_odds)


def initial_beliefs(prior: Objects, response: Tensor, noise: Noise, diffuse: Tensor | None = None) -> Beliefs:
    """Beliefs before any message: the predicted ones."""
    weight = prior.log_weight.exp() * prior.transmits
    moment = with_diffuse(weighted_moment(response, weight), weight.sum(-1), diffuse)
    power = prior.mean_power
    return Beliefs(as_belief(prior), noise, moment, prior.existence[..., None] * power, power, diffuse)


def with_diffuse(moment: Tensor, transmission: Tensor, diffuse: Tensor | None) -> Tensor:
    """Moments `(*batch, I, M, M)` of all that objects send, from those of their responses.

    Args:
        moment: of the responses.
        transmission: `(*batch,)` probability that the object transmits.
        diffuse: covariance of what it then sends beside its response, if anything.
    """
    return moment if diffuse is None else moment + transmission[..., None, None, None] * diffuse


def strongest_first(strength: Tensor) -> Tensor:
    """Slots by decreasing total strength, `(*batch, N, I)` to `(*batch, N)` int64; ties keep their order."""
    return torch.sort(strength.sum(-1), dim=-1, descending=True, stable=True).indices


def background(
    beliefs: Beliefs,
    measurement: Measurement,
    index: Tensor,
    extra_signal: Tensor | None = None,
    noise_model: NoiseModel = WHITE,
) -> Tensor:
    """What one object per batch element is tested against, `(*batch, I, M, M)`.

    `Sigma = sum_{m != n} strength_m E[a_m a_m^H] + E[eta] I` (white noise), and the diffuse part of object n
    itself, at its power given existence: what no response explains must not count as evidence for one.

    Args:
        beliefs: of all objects.
        measurement: statistics of the step.
        index: `(*batch,)` the object.
        extra_signal: `(*batch, I, M, M)` covariance of signals that are no objects yet.
        noise_model: what the noise makes of the covariance of the data.
    """
    signal = signal_covariance(without(beliefs.strength, index), beliefs.moment)
    signal = signal if extra_signal is None else signal + extra_signal
    if beliefs.diffuse is not None:
        signal = signal + take(beliefs.power, index)[..., None, None] * take(beliefs.diffuse, index)
    return noise_model.covariance(signal, beliefs.noise.mean, measurement.present)


def store(beliefs: Beliefs, index: Tensor, slot: ObjectBelief, prior: Objects, response: Tensor) -> Beliefs:
    """Put the new belief of one slot per batch element in its place, with its moments.

    Args:
        beliefs: of all objects.
        index: `(*batch,)` slots.
        slot: new belief.
        prior: of all objects, on the particles of this step.
        response: `(*batch, I, P, M)` of the particles; zero where they do not transmit.
    """
    mean_power = weighted_mean(take(prior.power, index), slot.log_power_weight)
    moment = response_moment(response, slot.log_weight)
    if beliefs.diffuse is not None:
        transmission = weighted_mean(take(prior.transmits, index), slot.log_weight)
        moment = with_diffuse(moment, transmission, take(beliefs.diffuse, index))
    strength = torch.sigmoid(slot.log_odds)[..., None] * mean_power
    return beliefs._replace(
        objects=tree_map(lambda old, new: put(old, index, new), beliefs.objects, slot),
        moment=put(beliefs.moment, index, moment),
        strength=put(beliefs.strength, index, strength),
        power=put(beliefs.power, index, mean_power),
    )


@runtime_checkable
class Schedule(Protocol):
    """The order of the messages of one pass."""

    def sweep(
        self,
        prior: Objects,
        response: Tensor,
        measurement: Measurement,
        beliefs: Beliefs,
        noise_model: NoiseModel,
    ) -> Beliefs:
        """Beliefs of all objects renewed once; that of the noise stays.

        Args:
            prior: predicted objects, batch `(*batch, N)`.
            response: `(*batch, N, I, P, M)` complex responses of the particles.
            measurement: statistics of the step, batch `(*batch,)`.
            beliefs: before this pass.
            noise_model: what the noise makes of the covariance of the data.
        """
        ...


@dataclass(frozen=True)
class Sequential:
    """One object after another, strongest first, each against the newest beliefs of the others."""

    def sweep(
        self,
        prior: Objects,
        response: Tensor,
        measurement: Measurement,
        beliefs: Beliefs,
        noise_model: NoiseModel,
    ) -> Beliefs:
        """See `Schedule.sweep`."""
        order = strongest_first(beliefs.strength)
        # Empty slots sort last and have nothing to say; how many there are differs across the batch.
        for visit in range(int(prior.log_odds.isfinite().sum(-1).max())):
            index = order[..., visit]
            whitener = whiten(measurement, background(beliefs, measurement, index, noise_model=noise_model))
            slot_response = take(response, index)
            slot_prior = tree_map(partial(take, index=index), as_belief(prior))
            slot = object_belief(whitener, slot_response, take(prior.power, index), slot_prior)
            beliefs = store(beliefs, index, slot, prior, slot_response)
        return beliefs


@dataclass(frozen=True)
class Flooding:
    """All objects at once, each against the beliefs of the last pass."""

    def sweep(
        self,
        prior: Objects,
        response: Tensor,
        measurement: Measurement,
        beliefs: Beliefs,
        noise_model: NoiseModel,
    ) -> Beliefs:
        """See `Schedule.sweep`."""
        per_object = measurement.unsqueeze()
        signal = signal_without_each(beliefs.strength, beliefs.moment)
        if beliefs.diffuse is not None:
            signal = signal + beliefs.power[..., None, None] * beliefs.diffuse
        noise = beliefs.noise.mean[..., None, :]
        whitener = whiten(per_object, noise_model.covariance(signal, noise, per_object.present))
        objects = object_belief(whitener, response, prior.power, as_belief(prior))
        power = weighted_mean(prior.power, objects.log_power_weight)
        moment = response_moment(response, objects.log_weight)
        return beliefs._replace(
            objects=objects,
            moment=with_diffuse(moment, weighted_mean(prior.transmits, objects.log_weight), beliefs.diffuse),
            strength=torch.sigmoid(objects.log_odds)[..., None] * power,
            power=power,
        )


SEQUENTIAL = Sequential()


def update(
    prior: Objects,
    response: Tensor,
    noise: Noise,
    measurement: Measurement,
    *,
    sweeps: int = 3,
    schedule: Schedule = SEQUENTIAL,
    initial: Beliefs | None = None,
    noise_model: NoiseModel = WHITE,
) -> Beliefs:
    """BP update of one time step on fixed particles.

    Args:
        prior: predicted objects, batch `(*batch, N)`.
        response: `(*batch, N, I, P, M)` complex responses of the particles.
        noise: predicted noise.
        measurement: statistics of the step, batch `(*batch,)`.
        sweeps: passes over all objects; the noise is updated after each.
        schedule: order of the messages.
        initial: beliefs to start from; the predicted ones if None.
        noise_model: what the noise makes of the covariance of the data.

    Raises:
        NumericalError: where a covariance is not positive definite or a message not finite.
    """
    beliefs = initial_beliefs(prior, response, noise) if initial is None else initial
    for _ in range(sweeps):
        beliefs = schedule.sweep(prior, response, measurement, beliefs, noise_model)
        signal = signal_covariance(beliefs.strength, beliefs.moment)
        beliefs = beliefs._replace(noise=noise_model.update(noise, measurement, signal))
    return beliefs
