"""The start of a step: where the objects are before the data."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.mixture import GaussianMixture, cluster_moments
from torchdt.core.resampling import scale_tril
from torchdt.core.trees import tree_map
from torchdt.core.weights import normalise
from torchdt.field.base import BaseField
from torchdt.filter.bp.beliefs import Beliefs, as_belief, initial_beliefs
from torchdt.filter.proposal.moved import diffuse_part, respond
from torchdt.filter.state import Objects, TrackerState
from torchdt.model.existence import condition_inside, predict_log_odds
from torchdt.model.model import Model
from torchdt.model.motion.driving import Gradient
from torchdt.model.part import append_dims
from torchdt.model.region import Region


class Predicted(NamedTuple):
    """Objects before the data of a step.

    Attributes:
        objects: with moved particles, batch `(*batch, N)`.
        density: of their states, batch `(*batch, N)`: the clusters of the last step's particles, moved; where
            they transmit, if some may be silent. Its weights add up to the probability of that.
        silent: the same where they do not; None where all transmit.
        response: `(*batch, N, I, P, M)` complex, or of fewer particles where these are enough.
        beliefs: before any message.
    """

    objects: Objects
    density: GaussianMixture
    silent: GaussianMixture | None
    response: Tensor
    beliefs: Beliefs


def predict(
    field: BaseField,
    region: Region,
    model: Model,
    step_s: float,
    state: TrackerState,
    draws: Tensor,
    gradient: Gradient,
    components: int = 1,
    num_particles: int | None = None,
) -> Predicted:
    """Move objects, powers and existence by one step; an object that leaves the region ends.

    Args:
        field: array response.
        region: region of interest.
        model: statistical model.
        step_s: time step in seconds.
        state: belief after the last step, strongest objects first; slots that are empty throughout the batch
            are left out of the result.
        draws: `(*batch, N, P, num_driving)` standard normal.
        gradient: how the particles depend on the numbers of the motion.
        components: of the density of an object, at most; one has the mean and covariance of its particles.
        num_particles: number of particles whose responses suffice, for their moments; None takes all.
    """
    dim = state.objects.log_odds.ndim - 1
    occupied = max(1, int(state.objects.log_odds.isfinite().sum(-1).max()))
    old = tree_map(lambda t: t.narrow(dim, 0, occupied), state.objects)
    moved, log_ratio = model.motion.predict(old.state, draws.narrow(dim, 0, occupied), step_s, gradient)
    power = model.power.predict(old.power, old.log_power_weight)
    log_weight, log_inside = condition_inside(moved, old.log_weight + log_ratio, region)
    log_odds = predict_log_odds(old.log_odds, append_dims(model.survival, 1) * log_inside.exp())
    switch = model.power.switch
    transmits = old.transmits if switch is None else switch.predict(old.transmits)
    objects = Objects(moved, log_weight, *power, log_odds, old.label, transmits)
    weights = [old.log_weight]
    if switch is not None:
        weights = [old.log_weight + transmits.log(), old.log_weight + torch.log1p(-transmits)]
    density, *silent = (_mixture(model, old.state, weight, components, step_s) for weight in weights)
    every = 1 if num_particles is None else max(1, objects.state.shape[-2] // num_particles)
    observed = objects
    if every > 1:
        observed = objects._replace(
            state=objects.state[..., ::every, :],
            log_weight=normalise(objects.log_weight[..., ::every])[0],
            transmits=transmits[..., ::every],
        )
    response = respond(field, observed.state)
    diffuse = diffuse_part(field, objects.state, objects.log_weight)
    beliefs = initial_beliefs(observed, response, state.noise, diffuse)._replace(objects=as_belief(objects))
    return Predicted(objects, density, silent[0] if silent else None, response, beliefs)


def _mixture(
    model: Model, state: Tensor, log_weight: Tensor, components: int, step_s: float
) -> GaussianMixture:
    """Clusters of particles, moved; neither log-weights `(*batch, N, P)` nor theirs need add up to one."""
    within, log_total = normalise(log_weight)
    log_share, mean, covariance = cluster_moments(state, within, components)
    size = mean.shape[-3:-1]
    mean, covariance = model.motion.moments(mean.flatten(-3, -2), covariance.flatten(-4, -3), step_s)
    tril = scale_tril(covariance).unflatten(-3, size)
    return GaussianMixture(log_share + log_total[..., None], mean.unflatten(-2, size), tril)


def exchangeable(predicted: Predicted, region: Region, within: float = 3.0) -> Tensor:
    """Pairs of objects that could change places, `(*batch, N, N)` bool: their predictions overlap.

    Args:
        predicted: objects before the data.
        region: of interest; only positions count.
        within: distance of the means of two of their components in standard deviations of their difference;
            three leave out one exchange in 400, at the price of few components of the sampled evidence.
    """
    log_share, mean, tril = (t.detach() for t in predicted.density.marginal(region.num_coordinates))
    variance = tril.square().sum(-1)
    distance = region.difference(mean[..., :, None, :, None, :], mean[..., None, :, None, :, :]).square()
    spread = variance[..., :, None, :, None, :] + variance[..., None, :, None, :, :]
    there = log_share.isfinite() & predicted.objects.log_odds.isfinite()[..., None]
    both = there[..., :, None, :, None] & there[..., None, :, None, :]
    return (both & ((distance / spread).sum(-1) < within**2)).any(-1).any(-1)
