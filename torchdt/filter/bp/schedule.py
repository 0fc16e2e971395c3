"""The order in which messages are computed decides whether loopy BP succeeds.

`Sequential` visits the objects one after another, strongest (existence x power) first, per batch
element; each visit uses the newest beliefs of the others. `Flooding` computes all messages at once from
the beliefs of the last pass, as loopy BP is usually written; it finds ghosts beside strong sources and
may oscillate for ever where objects overlap.
"""

from dataclasses import dataclass
from functools import partial
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from torchdt.core.trees import put, take, tree_map
from torchdt.core.weights import weighted_mean
from torchdt.filter.bp.beliefs import Beliefs, as_belief, background, store, strongest_first, with_diffuse
from torchdt.filter.bp.doubt import Doubted, doubt
from torchdt.filter.bp.messages import object_belief
from torchdt.filter.bp.moments import response_moment, signal_covariance, signal_without_each, without
from torchdt.filter.bp.rank_one import Whitener, whiten
from torchdt.filter.interference.settings import NOTHING_ELSE, Interference
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import NoiseCovariance


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


def _judged(
    beliefs: Beliefs,
    measurement: Measurement,
    index: Tensor,
    others: Tensor,
    whitener: Whitener,
    new: Tensor,
    noise_model: NoiseCovariance,
    interference: Interference,
) -> Beliefs:
    """Beliefs in which the existence of one object per batch element has been doubted, see `doubt`.

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
    variance, power = beliefs.noise.mean, take(beliefs.power, index)
    modelled = beliefs.moment if beliefs.diffuse is None else beliefs.moment - beliefs.diffuse
    # Anew, not added to what is without it: the least noise that numbers can tell depends on the sum.
    signal = signal_covariance(without(beliefs.strength, index), beliefs.moment)
    signal = signal + power[..., None, None] * take(beliefs.moment, index)
    together = noise_model.covariance(signal, variance, measurement.present)
    seen = measurement, others, whitener, together, variance, beliefs.interferers
    of = Doubted(*seen, index, new, modelled, beliefs.strength, take(modelled, index), power)
    log_odds = take(beliefs.objects.log_odds, index) + doubt(of, interference)
    objects = beliefs.objects._replace(log_odds=put(beliefs.objects.log_odds, index, log_odds))
    strength = torch.sigmoid(log_odds)[..., None] * power
    return beliefs._replace(objects=objects, strength=put(beliefs.strength, index, strength))


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
                new = take(prior.log_odds, index) < 0
                seen = measurement, index, others, whitener, new, noise_model
                beliefs = _judged(beliefs, *seen, interference)
        return beliefs


def _for_each(of_all: Tensor, dim: int) -> Tensor:
    """What belongs to all objects `(*batch, N, ...)`, for each of them, `(*batch, N, N, ...)`."""
    num = of_all.shape[dim]
    return of_all.unsqueeze(dim).expand(*of_all.shape[:dim], num, *of_all.shape[dim:])


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
            dim, found = noise.ndim - 2, beliefs.interferers
            found = None if found is None else tree_map(lambda t: t.unsqueeze(dim), found)
            together = noise_model.covariance(
                signal + power[..., None, None] * moment, noise, per_object.present
            )
            strength = torch.sigmoid(objects.log_odds)[..., None] * power
            seen = per_object, others, whitener, together, noise, found
            of = Doubted(
                *seen,
                torch.arange(power.shape[-2], device=power.device).expand(objects.log_odds.shape),
                prior.log_odds < 0,
                _for_each(moment, dim),
                _for_each(strength, dim),
                moment,
                power,
            )
            objects = objects._replace(log_odds=objects.log_odds + doubt(of, interference))
        return beliefs._replace(
            objects=objects,
            moment=with_diffuse(moment, weighted_mean(prior.transmits, objects.log_weight), beliefs.diffuse),
            strength=torch.sigmoid(objects.log_odds)[..., None] * power,
            power=power,
        )


SEQUENTIAL = Sequential()
