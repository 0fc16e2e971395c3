"""The direct tracker: predict, place, update, report."""

import copy
import math
from functools import cached_property
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.data.prepare import Prepared, check_step, prepare, require_step
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField, Field, of_each, repeat_field
from torchdt.field.mismatch import with_share
from torchdt.field.wrapped import CompletedField
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.config import TrackerConfig
from torchdt.filter.context import StepContext
from torchdt.filter.declare import empty_slots, idle_particles, posterior, report
from torchdt.filter.explain import Explainer
from torchdt.filter.history import StepEstimate
from torchdt.filter.intensity.undetected import Undetected
from torchdt.filter.interference.settings import beside
from torchdt.filter.predict import Predicted, predict
from torchdt.filter.proposal.moved import Draws
from torchdt.filter.shares import energy_shares
from torchdt.filter.slots import Placed
from torchdt.filter.state import Objects, TrackerState
from torchdt.filter.tracker import Tracker
from torchdt.model.measurement import Measurement
from torchdt.model.model import Model
from torchdt.model.part import append_dims
from torchdt.model.prior import Priors
from torchdt.model.region import Region
from torchdt.model.wishart import log_normaliser

MOMENT_PARTICLES = 250
"""Particles of a predicted object from which the covariance of its response is taken, at least."""


class StepDraws(NamedTuple):
    """Random numbers of one step.

    Attributes:
        driving: `(*batch, N, P, num_driving)` standard normal, of the motion.
        known, newborn: of the proposals for known and new objects.
        picks: `(*batch, Q, rounds, S, d)` standard normal, for refining picks.
        evidence: of its estimate.
        marginals: of objects that overlap.
    """

    driving: Tensor
    known: Draws
    newborn: Draws
    picks: Tensor
    evidence: Any
    marginals: Any


class DirectTracker(Tracker[TrackerState]):
    """Tracks a fixed number of potential objects directly from array data.

    Everything is differentiable in the parameters of the model and in the field. Searches and fitted
    proposals are constants to the gradient: they decide where particles are, the weights make up for it.

    Args:
        field: array response, of which `config.mismatch_share` is not where it says.
        region: region of interest, less where the field says that no object can be; its dtype and device are
            those of the tracker.
        step_s: time step in seconds.
        config: numbers of the filter.
        model: statistical model; None is that of Liang and Meyer.

    Attributes:
        field: as the tracker asks it: with the share of mismatch, and of positions alone too.
        model: with all numbers as tensors.

    Raises:
        InputError: where field, region and settings do not fit each other.
    """

    field: BaseField
    config: TrackerConfig

    def __init__(
        self,
        field: Field,
        region: Region,
        step_s: float,
        config: TrackerConfig,
        model: Model | None = None,
    ):
        config.check_parts()
        model = Model() if model is None else model
        self.region, self.step_s, self.config = (
            region.within(field, model.motion),
            require_step(step_s),
            config,
        )
        self.field = CompletedField(field, self.region.complete)
        if config.mismatch_share is not None:
            anywhere = of_each(self.field, self.region.cell_centres()[:1])
            self.field = with_share(self.field, config.mismatch_share, anywhere)
        self.model = model.on(self.region)
        self.model.noise.check_array(self.field.num_tones, self.field.num_sensors)
        self._idle = idle_particles(self.region, config.particles)

    def select(self, sequences: slice) -> Self:
        """The same tracker for some sequences of its batch; what all sequences share stays shared."""
        field = self.field.select(sequences)
        return self._with_field(field, self.region.select(sequences), self.model.select(sequences))

    def repeat(self, number: int, model: Model) -> Self:
        """The same tracker for its batch repeated as a whole, with another model."""
        field = repeat_field(self.field, number)
        return self._with_field(field, self.region.within(field), model)

    def _with_field(self, field: BaseField, region: Region, model: Model) -> Self:
        other = self.with_model(model)
        if field is self.field:
            other.dictionary, other.undetected = self.dictionary, self.undetected
        else:
            other.field, other.region = field, region
            for name in ("dictionary", "undetected"):
                other.__dict__.pop(name, None)
        return other

    def with_model(self, model: Model) -> Self:
        """The same tracker with other numbers of the model."""
        other = copy.copy(self)
        other.model = model.on(self.region)
        return other

    def prepare(self, recording: Recording) -> Prepared:
        """Scale a recording and set its priors, see `prepare`.

        Raises:
            InputError: where it does not fit the tracker; also where its steps are of another length.
        """
        check_step(recording, self.step_s)
        return prepare(recording, self.field, self.region, self.config, self.model.effective_count)

    def init(self, priors: Priors) -> TrackerState:
        """State before the first step, k = 1: no objects, noise uniform up to `priors.noise_max` at k = 0."""
        cfg = self.config
        batch = priors.noise_max.shape[:-1]
        slots, num_tones = (*batch, cfg.slots), self.field.num_tones
        power, log_power_weight = self.model.power.initial(priors.power_max, cfg.power_points)
        objects = Objects(
            state=self._idle.expand(*slots, -1, -1),
            log_weight=self._idle.new_full((*slots, cfg.particles), -math.log(cfg.particles)),
            power=power.unsqueeze(-3).expand(*slots, num_tones, -1),
            log_power_weight=log_power_weight.unsqueeze(-3).expand(*slots, num_tones, -1),
            log_odds=self._idle.new_full(slots, -torch.inf),
            label=torch.zeros(slots, dtype=torch.int64, device=self._idle.device),
            transmits=self._idle.new_ones((*slots, cfg.particles)),
        )
        noise = self.model.noise.initial(priors.noise_max, cfg.noise_points)
        first = torch.ones(batch, dtype=torch.int64, device=self._idle.device)
        unseen = self._idle.new_zeros((*batch, 0)) if self.undetected is None else self.undetected.init(batch)
        size = num_tones, self.field.num_sensors, cfg.interference.signatures
        unheard = self._idle.new_zeros((*batch, *size), dtype=self._idle.dtype.to_complex())
        return TrackerState(objects, noise, first, unseen, unheard)

    @cached_property
    def undetected(self) -> Undetected | None:
        """What carries the intensity of undetected objects, if anything does."""
        # Kept for gradients too, which tensors made in inference mode are not for.
        with torch.inference_mode(False), torch.no_grad():
            return self.config.undetected.on(self.dictionary, self.region, self.model, self.step_s)

    def step(
        self, state: TrackerState, measurement: Measurement, priors: Priors, streams: RandomStreams
    ) -> tuple[TrackerState, StepEstimate]:
        """Take in one step of data.

        Args:
            state: belief after the last step, or `init(priors)`.
            measurement: statistics of this step, batch `(*batch,)`.
            priors: limits of the priors.
            streams: random numbers; the same amount is drawn in every step.

        Returns:
            The new belief, and the estimates of this step.

        Raises:
            NumericalError: where a covariance is not positive definite or a message not finite.
        """
        cfg, model = self.config, self.model
        draws = self.draw(streams)
        received, count = measurement, model.effective_count
        if count is not None:
            measurement = received.recounted(append_dims(count, 1))
        tempered = measurement.tempered(append_dims(model.likelihood_power, 1))
        # Noise that the numbers of this step cannot resolve is as good as the least that they can. The belief
        # that goes on keeps its support points.
        noise = model.noise.resolvable(state.noise, measurement, priors)
        predicted = self.predict(state._replace(noise=noise), draws.driving)
        context = StepContext(self.field, self.region, model, model.noise, tempered)
        places = draws.known, draws.newborn, draws.picks
        step = context, self.dictionary, cfg, predicted, state.interference, priors, places
        current, residual, beliefs = Explainer(*step).explain()
        context = context._replace(noise=beside(model.noise, beliefs.interferers))
        beliefs = cfg.marginals.refine(context, predicted, current, beliefs, draws.marginals)
        context = context._replace(measurement=measurement)
        log_evidence = self.evidence(context, predicted, current, beliefs, draws.evidence)
        objects, undetected = posterior(current.objects, beliefs), state.undetected
        if self.undetected is not None:
            known = predicted.objects.log_odds.shape[-1]
            # Those of the last pick, of which there are hardly ever as many.
            draws_of_one = draws.newborn.final[..., -1, :, :]
            residual = self.undetected.left(residual, context, known, beliefs)
            undetected, objects, log_unseen = self.undetected.step(
                undetected, context, objects, known, beliefs, residual, priors, cfg, draws_of_one
            )
            if cfg.evidence.knows_births:
                observed = (measurement.num_snapshots > 0).any(-1)
                log_evidence = log_evidence + torch.where(observed, log_unseen, 0.0)
        if count is not None:
            constant = log_normaliser(received, append_dims(count, 1)).to(log_evidence)
            log_evidence = log_evidence + constant.sum(-1)
        objects, next_label, estimate = report(objects, beliefs.noise, state, log_evidence, self.region, cfg)
        estimate = estimate._replace(shares=energy_shares(beliefs, measurement, model.noise))
        if not cfg.report_silent:
            heard = estimate.existence * estimate.transmission > cfg.declare
            estimate = estimate._replace(declared=estimate.declared & heard)
        objects = cfg.proposal.resample(objects, cfg.resampler, streams)
        noise = model.noise.predict(state.noise._replace(log_weight=beliefs.noise.log_weight))
        interference = state.interference if beliefs.interferers is None else beliefs.interferers.columns
        objects = empty_slots(objects, self._idle)
        return TrackerState(objects, noise, next_label, undetected, interference), estimate

    def draw(self, streams: RandomStreams) -> StepDraws:
        """Random numbers of a step, always as many, whatever the other sequences of the batch need."""
        cfg, d = self.config, self.region.num_coordinates
        size, entries = (*cfg.proposal.fit_size, d), d + self.model.motion.num_extra(d)
        return StepDraws(
            streams.normal(cfg.slots, cfg.particles, self.model.motion.num_driving(d)),
            Draws(streams.normal(cfg.slots, *size), streams.normal(cfg.slots, cfg.particles, entries)),
            Draws(streams.normal(cfg.births, *size), streams.normal(cfg.births, cfg.particles, entries)),
            streams.normal(cfg.births, *size),
            cfg.evidence.draw(streams, cfg.slots, cfg.births, self.field.num_tones),
            cfg.marginals.draw(streams, cfg.slots, cfg.births, self.field.num_tones),
        )

    def predict(self, state: TrackerState, draws: Tensor) -> Predicted:
        """Objects before the data of a step, see `torchdt.filter.predict.predict`."""
        cfg = self.config
        num_particles = MOMENT_PARTICLES if cfg.proposal.moves and not cfg.evidence.every_response else None
        where = self.field, self.region, self.model, self.step_s
        return predict(*where, state, draws, cfg.gradient, cfg.proposal.mixture_components, num_particles)

    def evidence(
        self, context: StepContext, predicted: Predicted, current: Placed, beliefs: Beliefs, draws: Any
    ) -> Tensor:
        """Evidence of the step, `(*batch,)`; zero where there are no data. The likelihood is not tempered."""
        estimator = self.config.evidence
        log_evidence = estimator.estimate(context, predicted, current, beliefs, draws)
        if self.undetected is None and estimator.knows_births:
            new_odds = current.objects.log_odds[..., predicted.objects.log_odds.shape[-1] :]
            log_evidence = log_evidence + self.model.birth.log_none(self.region, new_odds)
        if beliefs.interferers is not None:
            log_evidence = log_evidence - beliefs.interferers.cost.sum(-1)
        return torch.where((context.measurement.num_snapshots > 0).any(-1), log_evidence, 0.0)
