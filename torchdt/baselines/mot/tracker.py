"""Conventional tracking of points: predict, propose, update, report."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.baselines.detect.points import Points
from torchdt.baselines.mot.config import PointConfig
from torchdt.baselines.mot.likelihood import PointLikelihood
from torchdt.baselines.mot.update import update
from torchdt.core.random import RandomStreams
from torchdt.core.trees import tree_map
from torchdt.core.weights import effective_sample_size, normalise, standard_deviation, weighted_mean
from torchdt.data.prepare import require_step
from torchdt.filter.declare import declare, idle_particles, prune, put_idle
from torchdt.filter.history import StepEstimate
from torchdt.filter.slots import join, take_rows
from torchdt.model.existence import condition_inside, predict_log_odds
from torchdt.model.motion.base import Motion
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.motion.driving import Reparameterised
from torchdt.model.region import Region


class PointObjects(NamedTuple):
    """Beliefs about N potential objects; an empty slot has `log_odds` of minus infinity.

    Attributes:
        particles: `(*batch, N, P, D)`, positions first.
        log_weight: `(*batch, N, P)` normalised log-weights.
        log_odds: `(*batch, N)` log p(exists) / p(does not).
        label: `(*batch, N)` int64, 0 until the object is first declared.
        power: `(*batch, N, I)` power of each tone, squared units of the points' power.
    """

    particles: Tensor
    log_weight: Tensor
    log_odds: Tensor
    label: Tensor
    power: Tensor


class PointState(NamedTuple):
    """Everything a tracker of points needs to go on.

    Attributes:
        objects: beliefs after the last step, the most probable objects first.
        next_label: `(*batch,)` int64, next free label.
    """

    objects: PointObjects
    next_label: Tensor


class PointTracker:
    """Tracks a fixed number of potential objects from points, by belief propagation with particles.

    Args:
        region: region of interest; its dtype and device are those of the tracker.
        step_s: time step in seconds.
        config: numbers of the model and the filter.
        likelihood: how points arise from objects and from clutter.
        motion: of objects; None is constant velocity.

    Raises:
        InputError: where `step_s` is not positive or `driving_variance` not one number for each coordinate.
    """

    def __init__(
        self,
        region: Region,
        step_s: float,
        config: PointConfig,
        likelihood: PointLikelihood,
        motion: Motion | None = None,
    ):
        config.check_parts()
        self.region, self.step_s = region, require_step(step_s)
        self.config, self.likelihood = config, likelihood
        self.motion = (ConstantVelocity() if motion is None else motion).on(region)
        self._idle = idle_particles(region, config.particles)

    def init(self, batch: Sequence[int], num_tones: int) -> PointState:
        """State before the first step: no objects.

        Args:
            batch: leading dimensions of all points.
            num_tones: number I of tones of their power.
        """
        next_label = torch.ones(tuple(batch), dtype=torch.int64, device=self._idle.device)
        return PointState(self._blank((*batch, self.config.slots), num_tones), next_label)

    def step(
        self, state: PointState, points: Points, streams: RandomStreams
    ) -> tuple[PointState, StepEstimate]:
        """Take in the points of one step.

        A step without points counts as one in which every object was missed, also where no data were taken.

        Args:
            state: belief after the last step, or `init`.
            points: of this step, batch `(*batch,)`; those that are not present are not used.
            streams: random numbers; the same amount is drawn in every step.

        Returns:
            The new belief, and the estimates of this step. The
            power of an object is that of its points, averaged over the associations, where it has one, and
            stays where it has none. The noise is that of the points. The evidence is NaN: the model gives
            points a likelihood, but not the snapshots they were found in.

        Raises:
            NumericalError: where a likelihood is NaN or infinite.
        """
        cfg, size = self.config, self._idle.shape
        driving = streams.normal(
            cfg.slots, cfg.particles, self.motion.num_driving(self.region.num_coordinates)
        )
        proposed = streams.normal(points.present.shape[-1], *size)
        resampling = cfg.resampler.draw(streams, cfg.slots, *size)

        points = _without_last_absent(points)
        known = self._predict(state.objects, driving)
        objects = self._most_probable(self._update(known, points, proposed))
        declared, label, next_label = declare(objects.log_odds, objects.label, state.next_label, cfg)
        mean = self.region.wrap(weighted_mean(objects.particles.mT, objects.log_weight.unsqueeze(-2)))
        position = mean[..., : self.region.num_coordinates]
        estimate = StepEstimate(
            existence=torch.sigmoid(objects.log_odds),
            transmission=torch.ones_like(objects.log_odds),  # of points nobody knows
            declared=declared & self.region.reports(position),
            label=label,
            position=position,
            state=mean,
            state_std=standard_deviation(objects.particles, objects.log_weight),
            power=objects.power,
            noise=points.noise,
            shares=points.noise.new_zeros((*points.noise.shape, 4)),  # of points nobody knows
            effective_sample_size=effective_sample_size(objects.log_weight),
            failed=torch.zeros_like(points.noise[..., 0], dtype=torch.bool),
            log_evidence=torch.full_like(points.noise[..., 0], torch.nan),
        )
        particles, log_weight = cfg.resampler.resample(objects.particles, objects.log_weight, resampling)
        objects = objects._replace(particles=particles, log_weight=log_weight, label=label)
        return PointState(objects, next_label), estimate

    def _blank(self, slots: Sequence[int], num_tones: int) -> PointObjects:
        """Empty slots."""
        num = self.config.particles
        return PointObjects(
            particles=self._idle.expand(*slots, -1, -1),
            log_weight=self._idle.new_full((*slots, num), -math.log(num)),
            log_odds=self._idle.new_full(slots, -torch.inf),
            label=torch.zeros(tuple(slots), dtype=torch.int64, device=self._idle.device),
            power=self._idle.new_zeros(*slots, num_tones),
        )

    def _predict(self, objects: PointObjects, draws: Tensor) -> PointObjects:
        """Move the objects; slots that are empty throughout the batch are left out."""
        dim, occupied = objects.log_odds.ndim - 1, _largest_number(objects)
        old = tree_map(lambda t: t.narrow(dim, 0, occupied), objects)
        driving = draws.narrow(dim, 0, occupied)
        particles, _ = self.motion.predict(old.particles, driving, self.step_s, Reparameterised())
        log_weight, log_inside = condition_inside(particles, old.log_weight, self.region)
        log_odds = predict_log_odds(old.log_odds, self.config.survival * log_inside.exp())
        return old._replace(particles=particles, log_weight=log_weight, log_odds=log_odds)

    def _update(self, known: PointObjects, points: Points, draws: Tensor) -> PointObjects:
        """Known objects after the points, then a new object for each of these."""
        # A point that is not there is a false one for certain.
        log_clutter = self.likelihood.log_clutter(points.position)
        log_clutter = torch.where(points.present, log_clutter, torch.inf)
        draws = draws[..., : points.present.shape[-1], :, :]
        particles, log_weight = self.likelihood.propose(points.position, draws)
        log_weight, log_sum = normalise(log_weight)
        updated, log_odds = update(
            known.log_weight,
            known.log_odds,
            self.likelihood.log_likelihood(points.position, known.particles),
            log_sum - math.log(self.config.particles),
            log_clutter,
            self.config,
        )
        power = updated.taken[..., :1] * known.power + updated.taken[..., 1:] @ points.power
        old = (known.particles, updated.log_weight, updated.log_odds, known.label, power)
        new = (particles, log_weight, log_odds, torch.zeros_like(log_odds, dtype=torch.int64), points.power)
        return PointObjects(*join(old, new, known.log_odds.ndim - 1))

    def _most_probable(self, objects: PointObjects) -> PointObjects:
        """Objects by decreasing existence in as many slots as there are, improbable ones left out."""
        objects = objects._replace(log_odds=prune(objects.log_odds, self.config))
        num = min(self.config.slots, _largest_number(objects))
        order = torch.sort(objects.log_odds, stable=True, dim=-1, descending=True).indices[..., :num]
        chosen = [take_rows(t, order) for t in objects]
        rest = self._blank((*order.shape[:-1], self.config.slots - num), objects.power.shape[-1])
        kept = PointObjects(*join(chosen, rest, order.ndim - 1))
        kept = kept._replace(particles=self.region.gather(kept.particles, kept.log_weight))
        particles, log_weight = put_idle(kept.particles, kept.log_weight, kept.log_odds, self._idle)
        return kept._replace(particles=particles, log_weight=log_weight)


def _largest_number(objects: PointObjects) -> int:
    """Number of slots that some batch element needs, at least one."""
    return max(1, int((~objects.log_odds.isneginf()).sum(-1).max()))


def _without_last_absent(points: Points) -> Points:
    """Leave out the last points as long as no batch element has them; one remains."""
    place = torch.arange(1, points.present.shape[-1] + 1, device=points.present.device)
    used = max(1, int((points.present * place).max()))
    return Points(
        points.position[..., :used, :],
        points.strength[..., :used],
        points.power[..., :used, :],
        points.present[..., :used],
        points.noise,
    )
