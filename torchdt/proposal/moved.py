"""Proposals for objects that existed before: the prediction, adapted to the new data."""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.bp.messages import ObjectBelief, object_belief, state_message
from torchdt.bp.moments import response_moment
from torchdt.bp.rank_one import whiten
from torchdt.bp.schedule import Beliefs, as_belief, background, store, take
from torchdt.field.base import Field
from torchdt.field.mismatch import DiffuseField
from torchdt.model.kinematics import drop_outside
from torchdt.model.measurement import Measurement
from torchdt.model.region import Region
from torchdt.particles.adaptive import Gaussian, adapt
from torchdt.particles.resampling import scale_tril
from torchdt.particles.weights import mean_and_covariance
from torchdt.state import Objects, weighted_mean


class Draws(NamedTuple):
    """Standard normal draws for N objects.

    Attributes:
        rounds: `(*batch, N, rounds, S, d)` for fitting.
        final: `(*batch, N, P, 2 d)` for the particles.
    """

    rounds: Tensor
    final: Tensor


def respond(field: Field, state: Tensor) -> Tensor:
    """Responses with tones before particles: `(*batch, P, D)` to `(*batch, I, P, M)`."""
    return field(state).transpose(-3, -2)


def diffuse_part(field: Field, state: Tensor, log_weight: Tensor) -> Tensor | None:
    """Diffuse covariance of objects at their mean states, `(*batch, P, D)` to `(*batch, I, M, M)`, if any."""
    if not isinstance(field, DiffuseField):
        return None
    return field.diffuse(weighted_mean(state.mT, log_weight[..., None, :]))


def propose_adapted(
    field: Field,
    region: Region,
    predicted: Objects,
    beliefs: Beliefs,
    measurement: Measurement,
    draws: Draws,
    found: Tensor | None = None,
) -> tuple[Objects, Tensor, Beliefs]:
    """Redraw the particles of every object where prediction and likelihood meet.

    The predicted particles of an object enter through their mean and covariance. Positions come from a
    proposal fitted to `N(position) * likelihood`, rates from the predicted Gaussian given the position,
    and the weight is `N(position) / proposal(position)`: the likelihood is not part of it. Objects are
    visited in slot order, each against the newest beliefs of the others.

    Args:
        predicted: objects, batch `(*batch, N)`, strongest first.
        beliefs: predicted beliefs of the same objects.
        measurement: statistics of the step.
        draws: random numbers.
        found: `(*batch, I, M, M)` covariance of signals that are no objects yet.

    Returns:
        The objects with new particles; their responses `(*batch, N, I, P, M)`; beliefs after this first
        sequential sweep.
    """
    mean, covariance = mean_and_covariance(predicted.state, predicted.log_weight)
    states, log_weights, responses = [], [], []
    num_objects = predicted.log_odds.shape[-1]
    for slot in range(num_objects):
        index = torch.full_like(predicted.label[..., 0], slot)
        whitener = whiten(measurement, background(beliefs, measurement, index, found))
        slot_prior = ObjectBelief(*(take(t, index) for t in as_belief(predicted)))
        power = take(predicted.power, index)

        def log_likelihood(position: Tensor) -> Tensor:
            return state_message(whitener, respond(field, position), power, slot_prior.log_power_weight)  # noqa: B023

        state, log_weight = _draw(
            log_likelihood,
            take(mean, index),
            take(covariance, index),
            take(draws.rounds, index),
            take(draws.final, index),
        )
        log_weight = drop_outside(state, log_weight, region)
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


def _draw(
    log_likelihood: Callable[[Tensor], Tensor],
    mean: Tensor,
    covariance: Tensor,
    rounds: Tensor,
    final: Tensor,
) -> tuple[Tensor, Tensor]:
    """Particles of one object per batch element and their log prior over proposal, over P."""
    d = mean.shape[-1] // 2
    tril = scale_tril(covariance)
    # With L = [[A, 0], [B, C]] the rates given the position are N(m_v + B A^-1 (p - m_p), C C^T).
    prior = Gaussian(mean[..., :d], tril[..., :d, :d])
    mixture = adapt(log_likelihood, prior, rounds.movedim(-3, 0))
    position = mixture.sample(final[..., :d])
    whitened = torch.linalg.solve_triangular(
        prior.tril.mT, position - prior.mean[..., None, :], upper=True, left=False
    )
    rate = mean[..., None, d:] + whitened @ tril[..., d:, :d].mT + final[..., d:] @ tril[..., d:, d:].mT
    log_weight = prior.log_prob(position) - mixture.log_prob(position) - math.log(position.shape[-2])
    return torch.cat([position, rate], -1), log_weight
