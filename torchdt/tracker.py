"""The direct tracker: predict, adapt, birth, update, prune, estimate."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torchdt.bp.evidence import gaussian_evidence
from torchdt.bp.moments import signal_covariance
from torchdt.bp.schedule import Beliefs, initial_beliefs, strongest_first, take, update
from torchdt.config import TrackerConfig
from torchdt.detect.dictionary import build_dictionary
from torchdt.field.base import Field
from torchdt.history import TrackHistory
from torchdt.model.gamma_chain import predict_chain, uniform_prior
from torchdt.model.kinematics import drop_outside, predict_log_odds, predict_state
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors
from torchdt.model.region import Region
from torchdt.particles.resampling import roughen, systematic_indices
from torchdt.particles.weights import effective_sample_size
from torchdt.proposal.moved import Draws, propose_adapted, respond
from torchdt.proposal.newborn import propose_newborn, search
from torchdt.random import RandomStreams
from torchdt.state import Noise, Objects, TrackerState, weighted_mean


class DirectTracker:
    """Tracks a fixed number of potential objects directly from array data.

    Args:
        field: array response.
        region: region of interest; its dtype and device are those of the tracker.
        step_s: time step in seconds.
        config: numbers of the model and the filter.
    """

    def __init__(self, field: Field, region: Region, step_s: float, config: TrackerConfig):
        self.field, self.region, self.step_s, self.config = field, region, step_s, config
        self.dictionary = build_dictionary(field, region)
        self.birth_log_odds = config.birth_log_odds(region.num_cells)
        self.pick_threshold = config.pick_threshold(region.num_cells)
        # Particles of an empty slot: they mean nothing, but moments of them must stay finite.
        along = torch.linspace(0, 1, config.particles, dtype=region.low.dtype, device=region.low.device)[
            :, None
        ]
        self._idle = torch.cat(
            [
                torch.lerp(region.low, region.high, along),
                torch.lerp(region.rate_low, region.rate_high, along),
            ],
            -1,
        )

    def init(self, priors: Priors) -> TrackerState:
        """State before the first step: no objects, noise uniform up to `priors.noise_max`."""
        cfg = self.config
        batch = priors.noise_max.shape[:-1]
        slots, num_tones = (*batch, cfg.slots), self.field.num_tones
        power, log_power_weight = uniform_prior(priors.power_max, cfg.power_points)
        objects = Objects(
            state=self._idle.expand(*slots, -1, -1),
            log_weight=self._idle.new_full((*slots, cfg.particles), -math.log(cfg.particles)),
            power=power.unsqueeze(-3).expand(*slots, num_tones, -1),
            log_power_weight=log_power_weight.unsqueeze(-3).expand(*slots, num_tones, -1),
            log_odds=self._idle.new_full(slots, -torch.inf),
            label=torch.zeros(slots, dtype=torch.int64, device=self._idle.device),
        )
        noise = Noise(*uniform_prior(priors.noise_max, cfg.noise_points))
        return TrackerState(objects, noise, torch.ones(batch, dtype=torch.int64, device=self._idle.device))

    def run(
        self,
        measurement: Measurement,
        priors: Priors,
        streams: RandomStreams,
        on_step: Callable[[int, TrackHistory], None] | None = None,
    ) -> TrackHistory:
        """Track whole sequences.

        Args:
            measurement: statistics of batch `(*batch, K)`.
            priors: limits of the priors, batch `(*batch,)`.
            streams: random numbers of batch `(*batch,)`.
            on_step: called after each step with its index and the estimates of that step.
        """
        batch_dims = priors.noise_max.ndim - 1
        state, steps = self.init(priors), []
        for k in range(measurement.num_snapshots.shape[batch_dims]):
            state, estimate = self.step(state, measurement.at(k), priors, streams)
            steps.append(estimate)
            if on_step is not None:
                on_step(k, estimate)
        return TrackHistory(*(torch.stack(parts, batch_dims) for parts in zip(*steps, strict=True)))

    def step(
        self, state: TrackerState, measurement: Measurement, priors: Priors, streams: RandomStreams
    ) -> tuple[TrackerState, TrackHistory]:
        """Take in one step of data.

        Args:
            state: belief after the last step, or `init(priors)`.
            measurement: statistics of this step, batch `(*batch,)`.
            priors: limits of the priors.
            streams: random numbers; the same amount is drawn in every step.

        Returns:
            The new belief, and the estimates of this step: a `TrackHistory` without its time dimension.

        Raises:
            NumericalError: where a covariance is not positive definite or a message not finite.
        """
        cfg = self.config
        measurement = measurement.tempered(cfg.likelihood_power)
        known, noise = self._predict(state, streams)
        for_known, for_newborn, for_picks = self._draws(streams)
        response = respond(self.field, known.state)
        beliefs = initial_beliefs(known, response, noise)
        log_evidence = gaussian_evidence(beliefs, measurement)
        known, response, beliefs = self._update_known(known, response, beliefs, measurement, for_known)
        objects, response, beliefs = self._add_newborn(
            known, response, beliefs, noise, measurement, priors, for_picks, for_newborn
        )
        beliefs = update(
            objects, response, noise, measurement, sweeps=cfg.sweeps, schedule=cfg.schedule, initial=beliefs
        )
        return self._conclude(objects, beliefs, state, log_evidence, streams)

    def _update_known(
        self, known: Objects, response: Tensor, beliefs: Beliefs, measurement: Measurement, draws: Draws
    ) -> tuple[Objects, Tensor, Beliefs]:
        """First sweep over the known objects, so that new ones are looked for in what these leave."""
        cfg = self.config
        if cfg.proposal == "adapted":
            return propose_adapted(self.field, self.region, known, beliefs, measurement, draws)
        known = known._replace(log_weight=drop_outside(known.state, known.log_weight, self.region))
        first = update(
            known, response, beliefs.noise, measurement, sweeps=1, schedule=cfg.schedule, initial=beliefs
        )
        return known, response, first

    def _add_newborn(
        self,
        known: Objects,
        response: Tensor,
        beliefs: Beliefs,
        noise: Noise,
        measurement: Measurement,
        priors: Priors,
        for_picks: Tensor,
        draws: Draws,
    ) -> tuple[Objects, Tensor, Beliefs]:
        """Known and new objects together, with their responses and beliefs."""
        cfg, dim = self.config, known.log_odds.ndim - 1
        adapted = cfg.proposal == "adapted"
        field, region, limit = self.field, self.region, self.pick_threshold
        signal = signal_covariance(beliefs.strength, beliefs.moment)
        free = cfg.slots - known.log_odds.isfinite().sum(-1)
        picks, explained = search(
            field,
            region,
            self.dictionary,
            measurement,
            signal,
            noise,
            free,
            limit,
            for_picks,
            refine=adapted,
        )
        beliefs = beliefs._replace(noise=explained)
        if picks is None:
            return known, response, beliefs
        power = uniform_prior(priors.power_max, cfg.power_points)
        odds = self.birth_log_odds
        new, new_response = propose_newborn(
            field, region, measurement, signal, picks, explained, power, odds, draws, adapted=adapted
        )
        return (
            Objects(*_join(known, new, dim)),
            torch.cat([response, new_response], dim),
            _join_beliefs(beliefs, initial_beliefs(new, new_response, explained)),
        )

    def _predict(self, state: TrackerState, streams: RandomStreams) -> tuple[Objects, Noise]:
        """Predicted objects, strongest first and without the slots that are empty throughout, and noise."""
        cfg, old = self.config, state.objects
        d = self.region.num_coordinates
        driving = streams.normal(cfg.slots, cfg.particles, d)
        moved = predict_state(old.state, driving, self.step_s, self.region.driving_variance)
        power, log_power_weight = predict_chain(old.power, old.log_power_weight, cfg.power_shape)
        log_odds = predict_log_odds(old.log_odds, cfg.survival)
        objects = Objects(moved, old.log_weight, power, log_power_weight, log_odds, old.label)
        occupied = max(1, int(log_odds.isfinite().sum(-1).max()))
        noise = Noise(*predict_chain(state.noise.variance, state.noise.log_weight, cfg.noise_shape))
        return _select(objects, strongest_first(_strength(objects))[..., :occupied]), noise

    def _draws(self, streams: RandomStreams) -> tuple[Draws, Draws, Tensor]:
        """Random numbers of the proposals, always as many, whatever the other sequences of the batch need."""
        cfg, d = self.config, self.region.num_coordinates
        size = (cfg.rounds, cfg.round_size, d)
        moved = Draws(streams.normal(cfg.slots, *size), streams.normal(cfg.slots, cfg.particles, 2 * d))
        born = Draws(streams.normal(cfg.births, *size), streams.normal(cfg.births, cfg.particles, 2 * d))
        return moved, born, streams.normal(cfg.births, *size)

    def _conclude(
        self,
        prior: Objects,
        beliefs: Beliefs,
        old: TrackerState,
        log_evidence: Tensor,
        streams: RandomStreams,
    ) -> tuple[TrackerState, TrackHistory]:
        """Prune, label, estimate and resample."""
        cfg = self.config
        log_odds = beliefs.objects.log_odds
        log_odds = torch.where(torch.sigmoid(log_odds) < cfg.prune, -torch.inf, log_odds)
        objects = prior._replace(
            log_weight=beliefs.objects.log_weight,
            log_power_weight=beliefs.objects.log_power_weight,
            log_odds=log_odds,
        )
        objects = self._to_slots(objects, old.objects)
        declared = objects.existence > cfg.declare
        fresh = declared & (objects.label == 0)
        label = torch.where(fresh, old.next_label[..., None] + fresh.cumsum(-1) - 1, objects.label)
        objects = objects._replace(label=label)
        size = effective_sample_size(objects.log_weight)
        estimate = TrackHistory(
            existence=objects.existence,
            declared=declared,
            label=label,
            state=weighted_mean(objects.state.mT, objects.log_weight[..., None, :]),
            power=objects.mean_power,
            noise=beliefs.noise.mean,
            effective_sample_size=size,
            log_evidence=log_evidence,
        )
        state = TrackerState(
            self._resample(objects, size, streams), beliefs.noise, old.next_label + fresh.sum(-1)
        )
        return state, estimate

    def _to_slots(self, objects: Objects, empty: Objects) -> Objects:
        """Sort by strength into the fixed number of slots."""
        missing = self.config.slots - objects.log_odds.shape[-1]
        if missing > 0:
            blank = empty._replace(log_odds=torch.full_like(empty.log_odds, -torch.inf))
            blank = blank._replace(label=torch.zeros_like(empty.label))
            filler = _select(
                blank, torch.arange(missing, device=empty.label.device).expand(*empty.label.shape[:-1], -1)
            )
            objects = Objects(*_join(objects, filler, objects.log_odds.ndim - 1))
        return _select(objects, strongest_first(_strength(objects))[..., : self.config.slots])

    def _resample(self, objects: Objects, size: Tensor, streams: RandomStreams) -> Objects:
        cfg = self.config
        offset = streams.uniform(cfg.slots)
        draws = streams.normal(*objects.state.shape[-3:])
        ancestors = systematic_indices(objects.log_weight, offset)
        particles = objects.state.gather(-2, ancestors[..., None].expand_as(objects.state))
        even = torch.full_like(objects.log_weight, -math.log(cfg.particles))
        particles = roughen(particles, even, draws, cfg.roughening)
        poor = size < cfg.resample_below * cfg.particles
        state = torch.where(poor[..., None, None], particles, objects.state)
        log_weight = torch.where(poor[..., None], even, objects.log_weight)
        empty = objects.log_odds.isneginf()
        return objects._replace(
            state=torch.where(empty[..., None, None], self._idle, state),
            log_weight=torch.where(empty[..., None], even, log_weight),
        )


def _strength(objects: Objects) -> Tensor:
    """`r E[gamma]`, minus infinity for empty slots so that they sort last."""
    strength = objects.existence[..., None] * objects.mean_power
    return torch.where(objects.log_odds.isfinite()[..., None], strength, -torch.inf)


def _select(objects: Objects, index: Tensor) -> Objects:
    """Objects at `(*batch, N')` slot indices of `(*batch, N)`."""
    dim = index.ndim - 1
    parts = (torch.stack([take(t, i) for i in index.unbind(-1)], dim) for t in objects)
    return Objects(*parts)


def _join(first: Sequence[Tensor], second: Sequence[Tensor], dim: int) -> list[Tensor]:
    """Concatenate tuples of tensors field by field."""
    return [torch.cat([a, b], dim) for a, b in zip(first, second, strict=True)]


def _join_beliefs(known: Beliefs, new: Beliefs) -> Beliefs:
    dim = known.objects.log_odds.ndim - 1
    return known._replace(
        objects=type(known.objects)(*_join(known.objects, new.objects, dim)),
        moment=torch.cat([known.moment, new.moment], dim),
        strength=torch.cat([known.strength, new.strength], dim),
    )
