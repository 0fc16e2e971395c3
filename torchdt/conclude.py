"""The end of a step: prune, label, estimate, resample."""

import torch
from torch import Tensor

from torchdt.bp.schedule import Beliefs
from torchdt.config import TrackerConfig
from torchdt.history import TrackHistory
from torchdt.model.region import Region
from torchdt.particles.resampling import roughen, stop_gradient_weights, systematic_indices
from torchdt.particles.weights import effective_sample_size
from torchdt.random import RandomStreams
from torchdt.slots import fit_slots
from torchdt.state import Objects, TrackerState, weighted_mean


def idle_particles(region: Region, num_particles: int) -> Tensor:
    """Particles of an empty slot, `(P, D)`: they mean nothing, but moments of them must stay finite."""
    along = torch.linspace(0, 1, num_particles, dtype=region.low.dtype, device=region.low.device)[:, None]
    position = torch.lerp(region.low, region.high, along)
    return torch.cat([position, torch.lerp(region.rate_low, region.rate_high, along)], -1)


def conclude(
    prior: Objects, beliefs: Beliefs, old: TrackerState, log_evidence: Tensor, config: TrackerConfig
) -> tuple[Objects, Tensor, TrackHistory]:
    """Drop improbable objects, name those declared for the first time, and report.

    Args:
        prior: known and new objects with the particles of this step, batch `(*batch, N')`.
        beliefs: posterior beliefs about them.
        old: state before the step, of N slots.
        log_evidence: `(*batch,)`.
        config: thresholds.

    Returns:
        Posterior objects of batch `(*batch, N)`, strongest first; the next free label; the estimates.
    """
    log_odds = beliefs.objects.log_odds
    log_odds = torch.where(torch.sigmoid(log_odds) < config.prune, -torch.inf, log_odds)
    objects = prior._replace(
        log_weight=beliefs.objects.log_weight,
        log_power_weight=beliefs.objects.log_power_weight,
        log_odds=log_odds,
    )
    objects = fit_slots(objects, old.objects)
    declared = objects.existence > config.declare
    fresh = declared & (objects.label == 0)
    label = torch.where(fresh, old.next_label[..., None] + fresh.cumsum(-1) - 1, objects.label)
    label = torch.where(objects.log_odds.isneginf(), 0, label)
    estimate = TrackHistory(
        existence=objects.existence,
        declared=declared,
        label=label,
        state=weighted_mean(objects.state.mT, objects.log_weight[..., None, :]),
        power=objects.mean_power,
        noise=beliefs.noise.mean,
        effective_sample_size=effective_sample_size(objects.log_weight),
        log_evidence=log_evidence,
    )
    return objects._replace(label=label), old.next_label + fresh.sum(-1), estimate


def resample(objects: Objects, config: TrackerConfig, streams: RandomStreams) -> Objects:
    """Equal weights where too few particles carry them.

    The weights keep their gradient, see `stop_gradient_weights`.
    """
    offset = streams.uniform(config.slots)
    draws = streams.normal(*objects.state.shape[-3:])
    ancestors = systematic_indices(objects.log_weight, offset)
    particles = objects.state.gather(-2, ancestors[..., None].expand_as(objects.state))
    log_weight = stop_gradient_weights(objects.log_weight, ancestors)
    particles = roughen(particles, log_weight.detach(), draws, config.roughening)
    poor = effective_sample_size(objects.log_weight) < config.resample_below * config.particles
    return objects._replace(
        state=torch.where(poor[..., None, None], particles, objects.state),
        log_weight=torch.where(poor[..., None], log_weight, objects.log_weight),
    )


def empty_slots(objects: Objects, idle: Tensor) -> Objects:
    """Put idle particles `(P, D)` of equal weight into slots without an object."""
    empty = objects.log_odds.isneginf()
    even = -torch.log(torch.full_like(objects.log_weight, objects.log_weight.shape[-1]))
    return objects._replace(
        state=torch.where(empty[..., None, None], idle, objects.state),
        log_weight=torch.where(empty[..., None], even, objects.log_weight),
    )
