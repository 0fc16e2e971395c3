"""Direct tracking on the paper's own graph: predict, pick, pass messages, report."""

import copy
import math
from typing import NamedTuple, Self

import torch
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import Resampler, ResamplingDraws
from torchdt.data.prepare import Prepared, check_step, prepare, require_step
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField, Field
from torchdt.field.wrapped import CompletedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.declare import empty_slots, idle_particles, report
from torchdt.filter.history import StepEstimate
from torchdt.filter.paper.births import newborn, pick_cells
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.messages import pass_messages
from torchdt.filter.proposal.moved import respond
from torchdt.filter.slots import join
from torchdt.filter.state import Objects, TrackerState
from torchdt.filter.tracker import Tracker
from torchdt.model.existence import condition_inside, predict_log_odds
from torchdt.model.measurement import Measurement
from torchdt.model.model import Model
from torchdt.model.motion.driving import Score
from torchdt.model.noise.base import BaseNoise, Noise
from torchdt.model.part import append_dims
from torchdt.model.power.gamma import GammaPower
from torchdt.model.prior import Priors
from torchdt.model.region import Region


class PaperDraws(NamedTuple):
    """Random numbers of one step.

    Attributes:
        offsets: `(*batch, N, U)`, `(*batch, N, I, U)` and `(*batch, I, U)` uniform, for resampling states,
            powers and noise, as many as the resampler needs.
        jitter: `(*batch, N, P, D)` standard normal, for roughening states.
        driving: `(*batch, N, P, num_driving)` standard normal.
        power, noise: `(*batch, N, I, G)` and `(*batch, I, E)` Gamma of unit scale.
        along, extra: `(*batch, Q, P, d)` uniform and `(*batch, Q, P, num_extra)` standard normal, of new
            states.
        share: `(*batch, Q, I, G)` uniform, of their powers.
    """

    offsets: tuple[Tensor, Tensor, Tensor]
    jitter: Tensor
    driving: Tensor
    power: Tensor
    noise: Tensor
    along: Tensor
    extra: Tensor
    share: Tensor


class PaperTracker(Tracker[TrackerState]):
    """Tracks with the paper's graph, its particles and its numbers, see `torchdt.filter.paper.messages`.

    Made for comparison: particles are drawn from the prediction alone, new ones from the prior in the cells
    that matching pursuit picks. It has no gradients and no evidence.

    Args:
        field: array response.
        region: region of interest, less where the field says that no object can be; its dtype and device are
            those of the tracker.
        step_s: time step in seconds.
        config: numbers of the filter.
        model: statistical model; None is that of Liang and Meyer. Powers and noise levels must be Gamma
            chains, as theirs are: their transitions are drawn.

    Attributes:
        field: as the tracker asks it: of positions alone too.
        power_shape, noise_shape: c_gamma and c_eta of the model.

    Raises:
        InputError: where field, region, settings and model do not fit each other, or to the paper's graph.
    """

    field: BaseField
    config: PaperConfig

    def __init__(
        self,
        field: Field,
        region: Region,
        step_s: float,
        config: PaperConfig,
        model: Model | None = None,
    ):
        model = Model() if model is None else model
        self.region, self.step_s, self.config = (
            region.within(field, model.motion),
            require_step(step_s),
            config,
        )
        self.field = CompletedField(field, self.region.complete)
        self.model = model.on(self.region)
        power, noise = self.model.power, self.model.noise
        if not isinstance(power, GammaPower) or not isinstance(noise, BaseNoise):
            found = f"{type(power).__name__} and {type(noise).__name__}"
            raise InputError.of_key("model", found, "Gamma chains, whose transitions can be drawn")
        noise.check_array(self.field.num_tones, self.field.num_sensors)
        self.power_shape, self.noise_shape = power.power_shape, noise.noise_shape
        self._idle = idle_particles(self.region, config.particles)

    @property
    def births(self) -> int:
        """Number Q of cells in which new objects are considered in every step."""
        return min(self.config.births, self.region.num_cells)

    def select(self, sequences: slice) -> Self:
        """The same tracker for some sequences of its batch; what all sequences share stays shared."""
        field = self.field.select(sequences)
        if field is self.field:
            return self
        other = copy.copy(self)
        other.field, other.region = field, self.region.select(sequences)
        other.__dict__.pop("dictionary", None)
        return other

    def prepare(self, recording: Recording) -> Prepared:
        """Scale a recording and set its priors, see `prepare`.

        Raises:
            InputError: where it does not fit the tracker; also where its steps are of another length.
        """
        check_step(recording, self.step_s)
        limits = TrackerConfig(**{name: getattr(self.config, name) for name in Priors._fields})
        return prepare(recording, self.field, self.region, limits, self.model.effective_count)

    def init(self, priors: Priors) -> TrackerState:
        """State at k = 0: no objects, noise particles spread evenly up to `priors.noise_max`."""
        cfg, batch = self.config, priors.noise_max.shape[:-1]
        slots, tones = (*batch, cfg.slots), self.field.num_tones
        power = priors.power_max[..., None, :, None].expand(*slots, tones, cfg.power_particles)
        objects = Objects(
            state=self._idle.expand(*slots, -1, -1),
            log_weight=_even((*slots, cfg.particles), self._idle),
            power=power,
            log_power_weight=_even(power.shape, power),
            log_odds=self._idle.new_full(slots, -torch.inf),
            label=torch.zeros(slots, dtype=torch.int64, device=self._idle.device),
            transmits=self._idle.new_ones((*slots, cfg.particles)),
        )
        along = torch.arange(cfg.noise_particles, dtype=power.dtype, device=power.device) + 0.5
        variance = priors.noise_max[..., None] * along / cfg.noise_particles
        noise = Noise(variance, _even(variance.shape, variance))
        first = torch.ones(batch, dtype=torch.int64, device=self._idle.device)
        nothing = self._idle.new_zeros((*batch, 0))
        return TrackerState(objects, noise, first, nothing, nothing)

    @torch.no_grad()
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
            The new belief, and the estimates of this step. The
            evidence is NaN: on a graph with loops the messages have none.

        Raises:
            NumericalError: where a covariance is not positive definite or a message not finite.
        """
        cfg, model, draws = self.config, self.model, self.draw(streams)
        if model.effective_count is not None:
            measurement = measurement.recounted(append_dims(model.effective_count, 1))
        measurement = measurement.tempered(append_dims(model.likelihood_power, 1))
        known = self.predict_objects(state.objects, draws)
        noise = self.predict_noise(state.noise, draws)
        born = self.place_newborn(measurement, priors, draws)
        objects = Objects(*join(known, born, known.log_odds.ndim - 1))
        response = respond(self.field, objects.state)
        objects, noise = pass_messages(objects, response, noise, measurement, model.noise, cfg.iterations)
        no_evidence = torch.full_like(noise.mean[..., 0], torch.nan)
        objects, next_label, estimate = report(objects, noise, state, no_evidence, self.region, cfg)
        rest = next_label, state.undetected, state.interference
        return TrackerState(empty_slots(objects, self._idle), noise, *rest), estimate

    def draw(self, streams: RandomStreams) -> PaperDraws:
        """Random numbers of a step, always as many, whatever the other sequences of the batch need."""
        cfg, d, tones = self.config, self.region.num_coordinates, self.field.num_tones
        needed = cfg.resampler.num_uniforms
        offsets = (
            streams.uniform(cfg.slots, needed(cfg.particles)),
            streams.uniform(cfg.slots, tones, needed(cfg.power_particles)),
            streams.uniform(tones, needed(cfg.noise_particles)),
        )
        extra = self.model.motion.num_extra(d)
        return PaperDraws(
            offsets,
            streams.normal(cfg.slots, cfg.particles, d + extra),
            streams.normal(cfg.slots, cfg.particles, self.model.motion.num_driving(d)),
            streams.gamma(self.power_shape, cfg.slots, tones, cfg.power_particles),
            streams.gamma(self.noise_shape, tones, cfg.noise_particles),
            streams.uniform(self.births, cfg.particles, d),
            streams.normal(self.births, cfg.particles, extra),
            streams.uniform(self.births, tones, cfg.power_particles),
        )

    def predict_objects(self, objects: Objects, draws: PaperDraws) -> Objects:
        """Resample states and powers and draw their transitions: alpha and psi.

        Slots that are empty throughout the batch are left out. The states have the region as their support;
        an object of which no particle is left in it ends.

        Args:
            objects: after the last step, batch `(*batch, N)`, the strongest first.
            draws: of this step.
        """
        cfg, dim = self.config, objects.log_odds.ndim - 1
        occupied = max(1, int(objects.log_odds.isfinite().sum(-1).max()))

        def some(tensor: Tensor) -> Tensor:
            return tensor.narrow(dim, 0, occupied)

        old = Objects(*map(some, objects))
        resampling = ResamplingDraws(some(draws.offsets[0]), some(draws.jitter))
        state, log_weight = cfg.resampler.resample(old.state, old.log_weight, resampling)
        state, _ = self.model.motion.predict(state, some(draws.driving), self.step_s, Score())
        log_weight, _ = condition_inside(state, log_weight, self.region)
        power = resample_values(old.power, old.log_power_weight, some(draws.offsets[1]), cfg.resampler)
        log_odds = predict_log_odds(old.log_odds, append_dims(self.model.survival, 1))
        return Objects(
            state=state,
            log_weight=log_weight,
            power=power * some(draws.power) / append_dims(self.power_shape, 3),
            log_power_weight=_even(power.shape, power),
            log_odds=torch.where(self.region.contains(state).any(-1), log_odds, -torch.inf),
            label=old.label,
            transmits=old.transmits,
        )

    def predict_noise(self, noise: Noise, draws: PaperDraws) -> Noise:
        """Resample the noise variances and draw their transition: xi."""
        variance = resample_values(noise.variance, noise.log_weight, draws.offsets[2], self.config.resampler)
        variance = variance * draws.noise / append_dims(self.noise_shape, 2)
        return Noise(variance, _even(variance.shape, variance))

    def pick(self, measurement: Measurement) -> Tensor:
        """Cells for new objects, `(*batch, Q)` int64."""
        return pick_cells(self.dictionary, measurement, self.births)

    def place_newborn(self, measurement: Measurement, priors: Priors, draws: PaperDraws) -> Objects:
        """New objects in the cells picked, batch `(*batch, Q)`: alpha and psi."""
        return newborn(
            self.dictionary.points[self.pick(measurement)],
            self.region,
            self.model,
            priors.power_max,
            draws.along,
            draws.extra,
            draws.share,
        )


def resample_values(values: Tensor, log_weight: Tensor, uniform: Tensor, resampler: Resampler) -> Tensor:
    """Scalars `(*batch, G)` resampled with uniform draws `(*batch, U)`."""
    return values.gather(-1, resampler.ancestors(log_weight, uniform))


def _even(shape: torch.Size | tuple[int, ...], like: Tensor) -> Tensor:
    """Log-weights of particles that all count alike."""
    return like.new_full(shape, -math.log(shape[-1]))
