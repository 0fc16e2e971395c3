"""Proposals for objects that existed before: the prediction, adapted to the new data."""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.importance import Gaussian, adapt
from torchdt.core.resampling import scale_tril
from torchdt.core.trees import take
from torchdt.core.weights import weighted_mean
from torchdt.field.base import BaseField, Field
from torchdt.filter.bp.messages import ObjectBelief, object_belief, state_message
from torchdt.filter.bp.moments import response_moment
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.bp.schedule import Beliefs, as_belief, background, store
from torchdt.filter.state import Objects
from torchdt.model.existence import drop_outside
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import NoiseModel
from torchdt.model.noise.white import WHITE
from torchdt.model.region import Region


class Draws(NamedTuple):
    """Standard normal draws for N objects.

    Attributes:
        rounds: `(*batch, N, rounds, S, d)` for fitting.
        final: `(*batch, N, P, D)` for the particles.
    """

    rounds: Tensor
    final: Tensor


class Adapted(NamedTuple):
    """Drawn particles; constants to any gradient.

    Attributes:
        state: `(*batch, P, D)`.
        white: `(*batch, P, D)` the standard normal draws that the prediction maps to them.
        log_prior: `(*batch, P)` log-density of the prediction there.
        log_proposal: `(*batch, P)` log-density they were drawn with.
    """

    state: Tensor
    white: Tensor
    log_prior: Tensor
    log_proposal: Tensor


def respond(field: Field, state: Tensor) -> Tensor:
    """Responses with tones before particles: `(*batch, P, D)` to `(*batch, I, P, M)`."""
    return field(state).transpose(-3, -2)


def diffuse_part(field: BaseField, state: Tensor, log_weight: Tensor) -> Tensor | None:
    """Diffuse covariance of objects at their mean states, `(*batch, P, D)` to `(*batch, I, M, M)`, if any."""
    return field.diffuse(weighted_mean(state.mT, log_weight[..., None, :]))


def propose_adapted(
    field: Field,
    region: Region,
    predicted: Objects,
    moments: tuple[Tensor, Tensor],
    beliefs: Beliefs,
    measurement: Measurement,
    draws: Draws,
    found: Tensor | None = None,
    *,
    gradient: str = "score",
    noise_model: NoiseModel = WHITE,
) -> tuple[Objects, Tensor, Beliefs]:
    """Redraw the particles of every object where prediction and likelihood meet.

    The prediction of an object enters through its mean and covariance. Positions come from a proposal fitted
    to `N(position) * likelihood`, all else from the predicted Gaussian given the position, and the weight is
    `N(position) / proposal(position)`, N cut off at the edge of the region: the likelihood is not part of it.
    Objects are visited in slot order, each against the newest beliefs of the others.

    Args:
        predicted: objects, batch `(*batch, N)`, strongest first.
        moments: mean `(*batch, N, D)` and covariance `(*batch, N, D, D)` of their predicted states.
        beliefs: predicted beliefs of the same objects.
        measurement: statistics of the step.
        draws: random numbers.
        found: `(*batch, I, M, M)` covariance of signals that are no objects yet.
        gradient: how the particles depend on the prediction: `score` keeps them and moves their weights,
            `reparameterised` moves them.
        noise_model: what the noise makes of the covariance of the data.

    Returns:
        The objects with new particles; their responses `(*batch, N, I, P, M)`; beliefs after this first
        sequential sweep.
    """
    mean, covariance = moments
    log_inside = _log_inside(region, mean, covariance, draws.rounds, gradient)
    states, log_weights, responses = [], [], []
    num_objects = predicted.log_odds.shape[-1]
    for slot in range(num_objects):
        index = torch.full_like(predicted.label[..., 0], slot)
        whitener = whiten(measurement, background(beliefs, measurement, index, found, noise_model))
        slot_prior = ObjectBelief(*(take(t, index) for t in as_belief(predicted)))
        power = take(predicted.power, index)

        def log_likelihood(state: Tensor) -> Tensor:
            return state_message(whitener, respond(field, state), power, slot_prior.log_power_weight)  # noqa: B023

        prediction = Gaussian(take(mean, index), scale_tril(take(covariance, index)))
        drawn = draw_adapted(log_likelihood, prediction, take(draws.rounds, index), take(draws.final, index))
        if gradient == "reparameterised":
            state, log_prior = prediction.sample(drawn.white), drawn.log_prior
        else:
            state, log_prior = drawn.state, prediction.log_prob(drawn.state)
        log_weight = log_prior - drawn.log_proposal - math.log(state.shape[-2])
        # Given that the object is still in the region; that it left is in the predicted existence.
        log_weight = drop_outside(state, log_weight, region) - take(log_inside, index)[..., None]
        response = respond(field, state)
        belief = object_belief(whitener, response, power, slot_prior._replace(log_weight=log_weight))
        beliefs = store(beliefs, index, belief, power, response_moment(response, belief.log_weight))
        states.append(state)
        log_weights.append(log_weight)
        responses.append(response)
    batch_dims = predicted.log_odds.ndim - 1
    objects = predicted._replace(
        state=torch.stack(states, batch_dims), log_weight=torch.stack(log_weights, batch_dims)
    )
    return objects, torch.stack(responses, batch_dims), beliefs


def _log_inside(region: Region, mean: Tensor, covariance: Tensor, rounds: Tensor, gradient: str) -> Tensor:
    """Log of the share of Gaussian predictions that lies in the region, `(*batch, N)`, by sampling them.

    Zero where all samples are inside. For `score` its gradient is that of the density at fixed samples; for
    `reparameterised`, where what crosses the edge of the region has no gradient, it has none either.
    """
    d = region.num_coordinates
    predicted = Gaussian(mean[..., :d], scale_tril(covariance[..., :d, :d]))
    rounds = rounds[..., : mean.shape[-2], :, :, :]
    position = predicted.sample(rounds.flatten(-3, -2)).detach()
    inside = region.contains(position)
    log_density = predicted.log_prob(position)
    log_ratio = log_density - log_density.detach()
    if gradient == "reparameterised":
        log_ratio = log_ratio.detach()
    num = position.shape[-2]
    # As if one sample more were inside where none is.
    total = torch.where(inside, log_ratio, -torch.inf).exp().sum(-1).clamp_min(1.0)
    return torch.where(inside.all(-1), 0.0, total.log() - math.log(num))


@torch.no_grad()
def draw_adapted(
    log_likelihood: Callable[[Tensor], Tensor], predicted: Gaussian, rounds: Tensor, final: Tensor
) -> Adapted:
    """Particles where a predicted Gaussian and a likelihood meet.

    Args:
        log_likelihood: maps states `(*batch, S, D)` to `(*batch, S)`.
        predicted: of the state.
        rounds: `(*batch, rounds, S, d)` standard normal draws.
        final: `(*batch, P, D)` standard normal draws.
    """
    d = rounds.shape[-1]
    prior = Gaussian(predicted.mean[..., :d], predicted.tril[..., :d, :d])

    # With L = [[A, 0], [B, C]] the rates given the position are N(m_v + B A^-1 (p - m_p), C C^T).
    def with_rates(position: Tensor, white_rate: Tensor) -> tuple[Tensor, Tensor]:
        white = torch.cat([prior.whiten(position), white_rate], -1)
        return torch.cat([position, predicted.sample(white)[..., d:]], -1), white

    def at_mean_rates(position: Tensor) -> Tensor:
        middle = position.new_zeros(*position.shape[:-1], final.shape[-1] - d)
        return log_likelihood(with_rates(position, middle)[0])

    mixture = adapt(at_mean_rates, prior, rounds.movedim(-3, 0))
    position = mixture.sample(final[..., :d])
    state, white = with_rates(position, final[..., d:])
    log_prior = predicted.log_prob(state)
    log_rate = log_prior - prior.log_prob(position)
    return Adapted(state, white, log_prior, mixture.log_prob(position) + log_rate)
