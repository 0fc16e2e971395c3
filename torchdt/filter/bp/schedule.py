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
from torchdt.filter.bp.rank_one import Whitener, whiten
from torchdt.filter.interference.settings import Interference, NoInterference
from torchdt.filter.interference.signatures import Interferers
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseCovariance
from torchdt.model.noise.white import WHITE

NOTHING_ELSE = NoInterference()

NOTHING = 1e-3
"""Nats that change no existence."""


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
        interferers: what is no object; None for nothing.
    """

    objects: ObjectBelief
    noise: Noise
    moment: Tensor
    strength: Tensor
    power: Tensor
    diffuse: Tensor | None = None
    interferers: Interferers | None = None

    @property
    def signal(self) -> Tensor:
        """Covariance of what all objects send, `(*batch, I, M, M)`."""
        return signal_covariance(self.strength, self.moment)


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
    noise_model: NoiseCovariance = WHITE,
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


def judged(
    beliefs: Beliefs,
    measurement: Measurement,
    index: Tensor,
    others: Tensor,
    whitener: Whitener,
    new: Tensor,
    noise_model: NoiseCovariance,
    interference: Interference,
) -> Beliefs:
    """The existence of one object per batch element, given that what it explains may be no object.

    Its odds compare all that is without it and all that is with it, each beside the best that a signal of
    free signature can do there; without it, beside an echo of a stronger object; with it, beside what its own
    response may leave.

    Args:
        beliefs: of all objects, the last message included.
        measurement: statistics of the step.
        index: `(*batch,)` the object.
        others: `(*batch, I, M, M)` what it was tested against.
        whitener: of that.
        new: `(*batch,)` bool, whether the object was improbable before the step.
        noise_model: what the noise makes of the covariance of the data.
        interference: what may be heard beside objects.
    """
    variance = beliefs.noise.mean
    modelled = beliefs.moment if beliefs.diffuse is None else beliefs.moment - beliefs.diffuse
    # One or the other stands for it, whichever does so better.
    without_it = torch.maximum(
        interference.rival(measurement, others, variance, beliefs.interferers),
        interference.echo(whitener, index, modelled, beliefs.strength, new),
    )
    if not bool((without_it > NOTHING).any()):
        return beliefs
    moment, power = take(modelled, index), take(beliefs.power, index)
    # Anew, not added to what is without it: the least noise that numbers can tell depends on the sum.
    signal = signal_covariance(without(beliefs.strength, index), beliefs.moment)
    signal = signal + power[..., None, None] * take(beliefs.moment, index)
    covariance = noise_model.covariance(signal, variance, measurement.present)
    with_it = torch.maximum(
        interference.rival(measurement, covariance, variance, beliefs.interferers),
        interference.leftover(measurement, others, moment, power),
    )
    change = with_it - without_it
    change = torch.where(without_it > NOTHING, change, 0.0)
    log_odds = take(beliefs.objects.log_odds, index) + change
    strength = torch.sigmoid(log_odds)[..., None] * take(beliefs.power, index)
    odds = put(beliefs.objects.log_odds, index, log_odds)
    return beliefs._replace(
        objects=beliefs.objects._replace(log_odds=odds), strength=put(beliefs.strength, index, strength)
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
        noise_model: NoiseCovariance,
        interference: Interference = NOTHING_ELSE,
    ) -> Beliefs:
        """Beliefs of all objects renewed once; that of the noise stays.

        Args:
            prior: predicted objects, batch `(*batch, N)`.
            response: `(*batch, N, I, P, M)` complex responses of the particles.
            measurement: statistics of the step, batch `(*batch,)`.
            beliefs: before this pass.
            noise_model: what the noise makes of the covariance of the data.
            interference: what may be heard beside objects.
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
        noise_model: NoiseCovariance,
        interference: Interference = NOTHING_ELSE,
    ) -> Beliefs:
        """See `Schedule.sweep`."""
        order = strongest_first(beliefs.strength)
        # Empty slots sort last and have nothing to say; how many there are differs across the batch.
        for visit in range(int(prior.log_odds.isfinite().sum(-1).max())):
            index = order[..., visit]
            others = background(beliefs, measurement, index, noise_model=noise_model)
            whitener = whiten(measurement, others)
            slot_response = take(response, index)
            slot_prior = tree_map(partial(take, index=index), as_belief(prior))
            slot = object_belief(whitener, slot_response, take(prior.power, index), slot_prior)
            beliefs = store(beliefs, index, slot, prior, slot_response)
            if interference.signatures:
                seen = measurement, index, others, whitener, take(prior.log_odds, index) < 0
                beliefs = judged(beliefs, *seen, noise_model, interference)
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
        noise_model: NoiseCovariance,
        interference: Interference = NOTHING_ELSE,
    ) -> Beliefs:
        """See `Schedule.sweep`."""
        per_object = measurement.unsqueeze()
        signal = signal_without_each(beliefs.strength, beliefs.moment)
        if beliefs.diffuse is not None:
            signal = signal + beliefs.power[..., None, None] * beliefs.diffuse
        noise = beliefs.noise.mean[..., None, :]
        others = noise_model.covariance(signal, noise, per_object.present)
        whitener = whiten(per_object, others)
        objects = object_belief(whitener, response, prior.power, as_belief(prior))
        power = weighted_mean(prior.power, objects.log_power_weight)
        moment = response_moment(response, objects.log_weight)
        if interference.signatures:
            own, found = power[..., None, None] * moment, beliefs.interferers
            if found is not None:
                found = tree_map(lambda t: t.unsqueeze(noise.ndim - 2), found)
            together = noise_model.covariance(signal + own, noise, per_object.present)
            with_it = torch.maximum(
                interference.rival(per_object, together, noise, found),
                interference.leftover(per_object, others, moment, power),
            )
            change = with_it - interference.rival(per_object, others, noise, found)
            objects = objects._replace(log_odds=objects.log_odds + change)
        return beliefs._replace(
            objects=objects,
            moment=with_diffuse(moment, weighted_mean(prior.transmits, objects.log_weight), beliefs.diffuse),
            strength=torch.sigmoid(objects.log_odds)[..., None] * power,
            power=power,
        )


SEQUENTIAL = Sequential()
