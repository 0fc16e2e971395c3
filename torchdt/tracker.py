"""The direct tracker: predict, adapt, birth, update, conclude."""

import copy
import math
from collections.abc import Callable
from typing import NamedTuple, Self

import torch
from torch import Tensor

from torchdt.bp.configurations import UniformDraws, draw_configurations, labellings
from torchdt.bp.evidence import gaussian_evidence, sampled_evidence
from torchdt.bp.moments import signal_covariance
from torchdt.bp.schedule import Beliefs, initial_beliefs, select, update
from torchdt.conclude import conclude, empty_slots, idle_particles, resample
from torchdt.config import TrackerConfig
from torchdt.detect.dictionary import build_dictionary
from torchdt.field.base import Field
from torchdt.history import TrackHistory
from torchdt.model.birth import birth_log_odds, log_no_birth
from torchdt.model.gamma_chain import predict_chain, uniform_prior
from torchdt.model.kinematics import drop_outside, predict_log_odds, predict_moments, predict_state
from torchdt.model.measurement import Measurement
from torchdt.model.parameters import Parameters, default_parameters, widen
from torchdt.model.prior import Priors
from torchdt.model.region import Region
from torchdt.particles.transition import drive
from torchdt.particles.weights import mean_and_covariance
from torchdt.proposal.moved import Draws, diffuse_part, propose_adapted, respond
from torchdt.proposal.newborn import Picks, propose_newborn, search
from torchdt.random import RandomStreams
from torchdt.slots import Placed, join, join_beliefs
from torchdt.state import Noise, Objects, TrackerState


class Predicted(NamedTuple):
    """Objects before the data of a step.

    Attributes:
        objects: with moved particles, batch `(*batch, N)`.
        moments: mean `(*batch, N, D)` and covariance `(*batch, N, D, D)` of their states.
        response: `(*batch, N, I, P, M)` complex.
        beliefs: before any message.
    """

    objects: Objects
    moments: tuple[Tensor, Tensor]
    response: Tensor
    beliefs: Beliefs


class DirectTracker:
    """Tracks a fixed number of potential objects directly from array data.

    Everything is differentiable in the parameters of the model and in the field. Searches and fitted proposals
    are constants to the gradient: they decide where particles are, the weights make up for it.

    Args:
        field: array response.
        region: region of interest; its dtype and device are those of the tracker.
        step_s: time step in seconds.
        config: numbers of the model and the filter.
        parameters: numbers of the model as tensors; None takes those of `config` and `region`.
    """

    def __init__(
        self,
        field: Field,
        region: Region,
        step_s: float,
        config: TrackerConfig,
        parameters: Parameters | None = None,
    ):
        self.field, self.region, self.step_s, self.config = field, region, step_s, config
        self.parameters = default_parameters(config, region) if parameters is None else parameters
        self.dictionary = build_dictionary(field, region)
        self._idle = idle_particles(region, config.particles)

    def with_parameters(self, parameters: Parameters) -> Self:
        """The same tracker with other numbers of the model."""
        other = copy.copy(self)
        other.parameters = parameters
        return other

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
        cfg, parameters = self.config, self.parameters
        draws = self._draws(streams)
        tempered = measurement.tempered(widen(parameters.likelihood_power, 1))
        predicted, noise = self._predict(state, streams), state.noise
        current = self._place(predicted, noise, tempered, priors, draws)
        beliefs = update(
            current.objects,
            current.response,
            noise,
            tempered,
            sweeps=cfg.sweeps,
            schedule=cfg.schedule,
            initial=current.beliefs,
        )
        log_evidence = self._evidence(predicted, current, noise, measurement, beliefs, draws)
        objects, next_label, estimate = conclude(current.objects, beliefs, state, log_evidence, cfg)
        if cfg.proposal == "prior":
            objects = resample(objects, cfg, streams)
        chain = predict_chain(
            beliefs.noise.variance, beliefs.noise.log_weight, widen(parameters.noise_shape, 1)
        )
        return TrackerState(empty_slots(objects, self._idle), Noise(*chain), next_label), estimate

    def _draws(self, streams: RandomStreams) -> "StepDraws":
        """Random numbers of a step, always as many, whatever the other sequences of the batch need."""
        cfg, d = self.config, self.region.num_coordinates
        size = (cfg.rounds, cfg.round_size, d)
        return StepDraws(
            Draws(streams.normal(cfg.slots, *size), streams.normal(cfg.slots, cfg.particles, 2 * d)),
            Draws(streams.normal(cfg.births, *size), streams.normal(cfg.births, cfg.particles, 2 * d)),
            streams.normal(cfg.births, *size),
            UniformDraws.draw(streams, cfg.slots + cfg.births, self.field.num_tones, cfg.evidence_samples),
        )

    def _predict(self, state: TrackerState, streams: RandomStreams) -> Predicted:
        """Predicted objects, without the slots that are empty throughout the batch."""
        cfg, parameters = self.config, self.parameters
        dim = state.objects.log_odds.ndim - 1
        draws = streams.normal(cfg.slots, cfg.particles, self.region.num_coordinates)
        # The last step left the slots strongest first, and empty ones at the end.
        occupied = max(1, int(state.objects.log_odds.isfinite().sum(-1).max()))
        old = Objects(*(t.narrow(dim, 0, occupied) for t in state.objects))
        variance = parameters.driving_variance.unsqueeze(-2)
        driving, log_ratio = drive(draws.narrow(dim, 0, occupied), variance, cfg.gradient)
        power, log_power_weight = predict_chain(
            old.power, old.log_power_weight, widen(parameters.power_shape, 2)
        )
        objects = Objects(
            predict_state(old.state, driving, self.step_s),
            old.log_weight + log_ratio,
            power,
            log_power_weight,
            predict_log_odds(old.log_odds, widen(parameters.survival, 1)),
            old.label,
        )
        moments = predict_moments(
            *mean_and_covariance(old.state, old.log_weight), self.step_s, variance
        )
        response = respond(self.field, objects.state)
        diffuse = diffuse_part(self.field, objects.state, objects.log_weight)
        return Predicted(objects, moments, response, initial_beliefs(objects, response, state.noise, diffuse))

    def _place(
        self, predicted: Predicted, noise: Noise, measurement: Measurement, priors: Priors, draws: "StepDraws"
    ) -> Placed:
        """Known and new objects on the particles of this step, and beliefs to start the update from."""
        cfg = self.config
        log_odds = birth_log_odds(self.parameters.birth_mean, self.region.num_cells)
        first = self._place_known(predicted, predicted.beliefs, measurement, draws.known)
        with torch.no_grad():
            picks, explained = search(
                self.field,
                self.region,
                self.dictionary,
                measurement,
                signal_covariance(first.beliefs.strength, first.beliefs.moment),
                noise,
                cfg.slots - predicted.objects.log_odds.isfinite().sum(-1),
                cfg.pick_threshold(log_odds),
                draws.picks,
                refine=cfg.proposal == "adapted",
            )
        explained = Noise(*(t.detach() for t in explained))
        current = first._replace(beliefs=first.beliefs._replace(noise=explained))
        if picks is None:
            return current
        if cfg.proposal == "adapted":
            # Energy of objects not yet known has pulled at the known ones: place them again without it.
            found = signal_covariance(picks.power, picks.moment)
            start = predicted.beliefs._replace(noise=explained)
            again = self._place_known(predicted, start, measurement, draws.known, found)
            current = select(picks.active.any(-1), again, current)
        return self._add_newborn(current, picks, log_odds, measurement, priors, draws.newborn)

    def _place_known(
        self,
        predicted: Predicted,
        beliefs: Beliefs,
        measurement: Measurement,
        draws: Draws,
        found: Tensor | None = None,
    ) -> Placed:
        """First sweep over the known objects, so that new ones are looked for in what these leave."""
        cfg, known = self.config, predicted.objects
        if cfg.proposal == "adapted":
            placed = propose_adapted(
                self.field,
                self.region,
                known,
                predicted.moments,
                beliefs,
                measurement,
                draws,
                found,
                gradient=cfg.gradient,
            )
            return Placed(*placed)
        known = known._replace(log_weight=drop_outside(known.state, known.log_weight, self.region))
        first = update(
            known,
            predicted.response,
            beliefs.noise,
            measurement,
            sweeps=1,
            schedule=cfg.schedule,
            initial=beliefs,
        )
        return Placed(known, predicted.response, first)

    def _add_newborn(
        self,
        known: Placed,
        picks: Picks,
        log_odds: Tensor,
        measurement: Measurement,
        priors: Priors,
        draws: Draws,
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
            log_odds,
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

    def _evidence(
        self,
        predicted: Predicted,
        current: Placed,
        noise: Noise,
        measurement: Measurement,
        beliefs: Beliefs,
        draws: "StepDraws",
    ) -> Tensor:
        """Evidence of the step, `(*batch,)`; zero where there are no data. The likelihood is not tempered."""
        if self.config.evidence == "gaussian":
            log_evidence = gaussian_evidence(predicted.beliefs, measurement)
        else:
            known = predicted.objects.log_odds.shape[-1]
            new_odds = current.objects.log_odds[..., known:]
            chosen = draws.evidence.pick(known, self.config.slots, new_odds.shape[-1])
            known_pairs = exchangeable(predicted, self.region.num_coordinates)
            pairs = torch.nn.functional.pad(known_pairs, (0, new_odds.shape[-1]) * 2)
            components = labellings(current.objects, current.response, measurement, beliefs, pairs)
            drawn = draw_configurations(*components, beliefs.noise, chosen)
            log_evidence = sampled_evidence(
                current.objects, current.response, noise, measurement, drawn, beliefs.diffuse
            ) + log_no_birth(
                self.parameters.birth_mean, self.region.num_cells, new_odds.isfinite().sum(-1)
            )
        return torch.where((measurement.num_snapshots > 0).any(-1), log_evidence, 0.0)


def exchangeable(predicted: Predicted, num_coordinates: int, within: float = 3.0) -> Tensor:
    """Pairs of objects that could change places, `(*batch, N, N)` bool: their predictions overlap.

    Args:
        predicted: objects before the data.
        num_coordinates: d; only positions count.
        within: distance of the means in standard deviations of their difference.
    """
    mean, covariance = (t.detach()[..., :num_coordinates] for t in predicted.moments)
    variance = covariance.diagonal(dim1=-2, dim2=-1)
    distance = (mean.unsqueeze(-2) - mean.unsqueeze(-3)).square()
    spread = variance.unsqueeze(-2) + variance.unsqueeze(-3)
    there = predicted.objects.log_odds.isfinite()
    both = there.unsqueeze(-1) & there.unsqueeze(-2)
    return both & ((distance / spread).sum(-1) < within**2)


class StepDraws(NamedTuple):
    """Random numbers of one step.

    Attributes:
        known, newborn: of the proposals for known and new objects.
        picks: `(*batch, Q, rounds, S, d)` standard normal, for refining picks.
        evidence: of the sampled evidence.
    """

    known: Draws
    newborn: Draws
    picks: Tensor
    evidence: UniformDraws
