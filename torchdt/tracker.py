"""The direct tracker: predict, adapt, birth, update, prune, estimate."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchdt.bp.evidence import gaussian_evidence
from torchdt.bp.moments import signal_covariance
from torchdt.bp.schedule import Beliefs, initial_beliefs, select, update
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
from torchdt.proposal.moved import Draws, diffuse_part, propose_adapted, respond
from torchdt.proposal.newborn import Picks, propose_newborn, search
from torchdt.random import RandomStreams
from torchdt.slots import Placed, fit_slots, join, join_beliefs, strongest_slots, take_slots
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
        known, noise = self._predict(state, streams), state.noise
        for_known, for_newborn, for_picks = self._draws(streams)
        response = respond(self.field, known.state)
        diffuse = diffuse_part(self.field, known.state, known.log_weight)
        beliefs = initial_beliefs(known, response, noise, diffuse)
        log_evidence = gaussian_evidence(beliefs, measurement)
        first = self._update_known(known, response, beliefs, measurement, for_known)
        signal = signal_covariance(first.beliefs.strength, first.beliefs.moment)
        free = cfg.slots - known.log_odds.isfinite().sum(-1)
        picks, explained = search(
            self.field,
            self.region,
            self.dictionary,
            measurement,
            signal,
            noise,
            free,
            self.pick_threshold,
            for_picks,
            refine=cfg.proposal == "adapted",
        )
        current = first._replace(beliefs=first.beliefs._replace(noise=explained))
        if picks is not None:
            if cfg.proposal == "adapted":
                # Energy of objects not yet known has pulled at the known ones: place them again without it.
                found = signal_covariance(picks.power, picks.moment)
                start = beliefs._replace(noise=explained)
                again = self._update_known(known, response, start, measurement, for_known, found)
                current = select(picks.active.any(-1), again, current)
            current = self._add_newborn(current, picks, measurement, priors, for_newborn)
        beliefs = update(
            current.objects,
            current.response,
            noise,
            measurement,
            sweeps=cfg.sweeps,
            schedule=cfg.schedule,
            initial=current.beliefs,
        )
        return self._conclude(current.objects, beliefs, state, log_evidence, streams)

    def _update_known(
        self,
        known: Objects,
        response: Tensor,
        beliefs: Beliefs,
        measurement: Measurement,
        draws: Draws,
        found: Tensor | None = None,
    ) -> Placed:
        """First sweep over the known objects, so that new ones are looked for in what these leave."""
        cfg = self.config
        if cfg.proposal == "adapted":
            return Placed(
                *propose_adapted(self.field, self.region, known, beliefs, measurement, draws, found)
            )
        known = known._replace(log_weight=drop_outside(known.state, known.log_weight, self.region))
        first = update(
            known, response, beliefs.noise, measurement, sweeps=1, schedule=cfg.schedule, initial=beliefs
        )
        return Placed(known, response, first)

    def _add_newborn(
        self, known: Placed, picks: Picks, measurement: Measurement, priors: Priors, draws: Draws
    ) -> Placed:
        """Known and new objects together."""
        cfg, dim = self.config, picks.active.ndim - 1
        signal = signal_covariance(known.beliefs.strength, known.beliefs.moment)
        new, response = propose_newborn(
            self.field,
            self.region,
            measurement,
            signal,
            picks,
            known.beliefs.noise,
            uniform_prior(priors.power_max, cfg.power_points),
            self.birth_log_odds,
            draws,
            adapted=cfg.proposal == "adapted",
        )
        # What a pick sends beside its response is judged by the power it was picked with.
        newborn = initial_beliefs(new, response, known.beliefs.noise, picks.diffuse)._replace(
            power=picks.power
        )
        return Placed(
            Objects(*join(known.objects, new, dim)),
            torch.cat([known.response, response], dim),
            join_beliefs(known.beliefs, newborn),
        )

    def _predict(self, state: TrackerState, streams: RandomStreams) -> Objects:
        """Predicted objects, strongest first and without the slots that are empty throughout."""
        cfg, old = self.config, state.objects
        d = self.region.num_coordinates
        driving = streams.normal(cfg.slots, cfg.particles, d)
        moved = predict_state(old.state, driving, self.step_s, self.region.driving_variance)
        power, log_power_weight = predict_chain(old.power, old.log_power_weight, cfg.power_shape)
        log_odds = predict_log_odds(old.log_odds, cfg.survival)
        objects = Objects(moved, old.log_weight, power, log_power_weight, log_odds, old.label)
        occupied = max(1, int(log_odds.isfinite().sum(-1).max()))
        return take_slots(objects, strongest_slots(objects)[..., :occupied])

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
        objects = fit_slots(objects, old.objects)
        declared = objects.existence > cfg.declare
        fresh = declared & (objects.label == 0)
        label = torch.where(fresh, old.next_label[..., None] + fresh.cumsum(-1) - 1, objects.label)
        label = torch.where(objects.log_odds.isneginf(), 0, label)
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
        noise = Noise(*predict_chain(beliefs.noise.variance, beliefs.noise.log_weight, cfg.noise_shape))
        state = TrackerState(self._resample(objects, size, streams), noise, old.next_label + fresh.sum(-1))
        return state, estimate

    def _resample(self, objects: Objects, size: Tensor, streams: RandomStreams) -> Objects:
        """Equal weights where too few particles carry them; idle particles in empty slots."""
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
