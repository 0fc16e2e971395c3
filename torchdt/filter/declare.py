"""The end of a step: prune, label, estimate."""

import torch
from torch import Tensor

from torchdt.core.weights import effective_sample_size, standard_deviation, weighted_mean
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.config import ObjectConfig
from torchdt.filter.history import StepEstimate
from torchdt.filter.slots import fit_slots
from torchdt.filter.state import Objects, TrackerState
from torchdt.model.noise.base import Noise
from torchdt.model.region import Region


def idle_particles(region: Region, num_particles: int) -> Tensor:
    """Particles of an empty slot, `(P, D)`: they mean nothing, but moments of them must stay finite."""
    along = torch.linspace(0, 1, num_particles, dtype=region.low.dtype, device=region.low.device)[:, None]
    position = torch.lerp(region.low, region.high, along)
    return region.complete(position)


def posterior(prior: Objects, beliefs: Beliefs) -> Objects:
    """Objects with the weights and odds that a step has given them, batch `(*batch, N)`."""
    return prior._replace(
        log_weight=beliefs.objects.log_weight,
        log_power_weight=beliefs.objects.log_power_weight,
        log_odds=beliefs.objects.log_odds,
    )


def report(
    objects: Objects,
    noise: Noise,
    old: TrackerState,
    log_evidence: Tensor,
    region: Region,
    config: ObjectConfig,
) -> tuple[Objects, Tensor, StepEstimate]:
    """Drop improbable objects, name those declared for the first time, and say what is known of each.

    Args:
        objects: after the step, batch `(*batch, N')`.
        noise: after the step.
        old: state before the step, of N slots.
        log_evidence: `(*batch,)`.
        region: of interest.
        config: thresholds.

    Returns:
        Posterior objects of batch `(*batch, N)`, strongest first; the next free label; the estimates.
    """
    objects = objects._replace(
        state=region.gather(objects.state, objects.log_weight), log_odds=prune(objects.log_odds, config)
    )
    objects = fit_slots(objects, old.objects)
    declared, label, next_label = declare(objects.log_odds, objects.label, old.next_label, config)
    state = region.wrap(weighted_mean(objects.state.mT, objects.log_weight[..., None, :]))
    position = state[..., : region.num_coordinates]
    estimate = StepEstimate(
        existence=objects.existence,
        transmission=objects.transmission,
        declared=declared & region.reports(position),
        label=label,
        position=position,
        state=state,
        state_std=standard_deviation(objects.state, objects.log_weight),
        power=objects.mean_power,
        noise=noise.mean,
        shares=noise.mean.new_zeros((*noise.mean.shape, 4)),
        effective_sample_size=effective_sample_size(objects.log_weight),
        failed=torch.zeros_like(log_evidence, dtype=torch.bool),
        log_evidence=log_evidence,
    )
    return objects._replace(label=label), next_label, estimate


def prune(log_odds: Tensor, config: ObjectConfig) -> Tensor:
    """Drop improbable objects: log-odds of existence `(*batch,)`, minus infinity below the threshold."""
    return torch.where(torch.sigmoid(log_odds) < config.prune, -torch.inf, log_odds)


def declare(
    log_odds: Tensor, label: Tensor, next_label: Tensor, config: ObjectConfig
) -> tuple[Tensor, Tensor, Tensor]:
    """Report probable objects, and name those reported for the first time in the order of their slots.

    Args:
        log_odds: `(*batch, N)` of existence, minus infinity for an empty slot.
        label: `(*batch, N)` int64 before the step, 0 = none yet.
        next_label: `(*batch,)` int64, next free label.
        config: thresholds.

    Returns:
        Which objects are reported `(*batch, N)` bool, all labels, and the next free label.
    """
    declared = torch.sigmoid(log_odds) > config.declare
    fresh = declared & (label == 0)
    label = torch.where(fresh, next_label[..., None] + fresh.cumsum(-1) - 1, label)
    return declared, torch.where(log_odds.isneginf(), 0, label), next_label + fresh.sum(-1)


def empty_slots(objects: Objects, idle: Tensor) -> Objects:
    """Put idle particles `(P, D)` of equal weight into slots without an object."""
    state, log_weight = put_idle(objects.state, objects.log_weight, objects.log_odds, idle)
    return objects._replace(state=state, log_weight=log_weight)


def put_idle(state: Tensor, log_weight: Tensor, log_odds: Tensor, idle: Tensor) -> tuple[Tensor, Tensor]:
    """Particles and log-weights of slots, idle ones of equal weight where there is no object.

    Args:
        state: `(*batch, P, D)`.
        log_weight: `(*batch, P)` normalised.
        log_odds: `(*batch,)` of existence, minus infinity for an empty slot.
        idle: `(P, D)`.
    """
    empty = log_odds.isneginf()
    even = -torch.log(torch.full_like(log_weight, log_weight.shape[-1]))
    state = torch.where(empty[..., None, None], idle, state)
    return state, torch.where(empty[..., None], even, log_weight)
