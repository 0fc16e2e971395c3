"""Beliefs about all objects and the noise, and what they make of the background of each object."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.trees import put, take, tree_map
from torchdt.core.weights import weighted_mean
from torchdt.filter.bp.messages import ObjectBelief
from torchdt.filter.bp.moments import response_moment, signal_covariance, weighted_moment, without
from torchdt.filter.interference.signatures import Interferers
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseCovariance
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
