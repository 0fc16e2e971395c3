"""What a step does with the intensity of undetected objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchdt.core.trees import select
from torchdt.core.weights import weighted_mean
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.context import StepContext
from torchdt.filter.intensity.grid import Hypotheses, lay_grid, transition
from torchdt.filter.intensity.intensity import predict_intensity, tone_powers, update_intensity
from torchdt.filter.intensity.levels import level_log_likelihood
from torchdt.filter.intensity.promote import candidate, give_back, neighbourhood, promote
from torchdt.filter.proposal.cells import Unexplained, cell_statistics, received_power
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.slots import join
from torchdt.filter.state import Objects
from torchdt.model.model import Model
from torchdt.model.part import append_dims
from torchdt.model.prior import Priors
from torchdt.model.region import Region

if TYPE_CHECKING:
    from torchdt.filter.config import TrackerConfig
    from torchdt.filter.intensity.settings import Intensity


@dataclass(frozen=True)
class Undetected:
    """The objects of which no potential object is made yet.

    Attributes:
        settings: of the intensity.
        grid: its hypotheses.
        moment: mean of `a a^H` over the cells, `(I, M, M)`, or one for each sequence.
        dictionary: responses on the grid of cells.
        region: of interest.
        step_s: time step in seconds.
    """

    settings: Intensity
    grid: Hypotheses
    moment: Tensor
    dictionary: Dictionary
    region: Region
    step_s: float

    @classmethod
    def of(
        cls, settings: Intensity, dictionary: Dictionary, region: Region, model: Model, step_s: float
    ) -> Undetected:
        """Lay the grid of a region."""
        level = settings.level(region.low)
        grid = lay_grid(region, model.motion, step_s, level, settings.hypotheses)
        response = dictionary.response
        moment = response.mT @ response.conj() / max(1, region.num_cells)
        return cls(settings, grid, moment, dictionary, region, step_s)

    def init(self, batch: torch.Size) -> Tensor:
        """Nothing undetected before the first step, `(*batch, V, L, C)`."""
        size = len(self.grid.node), len(self.grid.level), len(self.dictionary.points)
        return self.moment.real.new_zeros((*batch, *size))

    def step(
        self,
        intensity: Tensor,
        context: StepContext,
        objects: Objects,
        known: int,
        beliefs: Beliefs,
        residual: Unexplained,
        priors: Priors,
        config: TrackerConfig,
        draws: Tensor,
    ) -> tuple[Tensor, Objects, Tensor]:
        """The intensity and the potential objects after the step, and the evidence of what is undetected.

        Args:
            intensity: after the last step, `(*batch, V, L, C)`.
            context: field, region, model and data.
            objects: after the step, batch `(*batch, N)`.
            known: number of slots that were known before the step.
            beliefs: about the objects and the noise.
            residual: what the known objects leave unexplained; where new ones are better known than the
                intensity is around them, it is taken again.
            priors: limits of the priors.
            config: of the tracker.
            draws: `(*batch, P, D)` standard normal.
        """
        model = context.model
        kept, predicted = objects.existence >= config.prune, self.predict(intensity, model)
        most, new = self.settings.step_nats, torch.arange(kept.shape[-1], device=kept.device) >= known

        def updated(left: Unexplained) -> tuple[Tensor, Tensor, Tensor]:
            share = self.settings.unexplained(context.field, self.dictionary.points[:1])
            left = doubted(context, left, share)
            power, level_share = tone_powers(context, left.noise, self.moment, self.settings)
            ratio = log_ratio(context, left, power, level_share)
            return power, *update_intensity(predicted, ratio, model.likelihood_power, most)

        power, after, log_evidence = updated(residual)
        if bool(kept[..., known:].any()):
            near = self.around(objects)
            # The one that is worth more stands for both: a pick knows one step, the intensity many.
            odds = (after.sum((-3, -2))[..., None, :] * near).sum(-1)
            kept = kept & ~(new & (odds > objects.log_odds.exp()))
            objects = objects._replace(log_odds=objects.log_odds.masked_fill(new & ~kept, -torch.inf))
            some = (kept & new).any(-1)
            if bool(some.any()):
                gone = (new & ~kept)[..., None]
                others = beliefs._replace(strength=beliefs.strength.masked_fill(gone, 0.0))
                again = updated(left_by(context, others, self.dictionary))
                power, after, log_evidence = select(some, again, (power, after, log_evidence))
                after = without(after, (near & (kept & new)[..., None]).any(-2))
        dropped = ~kept & ~new & objects.log_odds.isfinite()
        after = give_back(self, after, objects, dropped, power)
        least = self.settings.promote / (1 - self.settings.promote)
        room = kept.sum(-1) < config.slots
        # What all cells together are not worth, no neighbourhood is.
        if bool((room & (after.sum((-3, -2, -1)) > least)).any()):
            near, odds = candidate(self, after)
            near = near & (room & (odds > least))[..., None]
            prior = priors.power_max, config.power_points
            one = promote(self, after, near, power, model.power, *prior, draws)
            objects = Objects(*join(objects, one, objects.log_odds.ndim - 1))
            after = without(after, near)
        return after, objects, log_evidence

    def left(self, residual: Unexplained, context: StepContext, known: int, beliefs: Beliefs) -> Unexplained:
        """What the known objects leave unexplained, taken again where interferers explain some of it.

        Args:
            residual: what the known objects leave.
            context: field, region, model and data.
            known: number of slots that were known before the step.
            beliefs: about the objects, the noise and interferers.
        """
        if beliefs.interferers is None or not beliefs.interferers.any:
            return residual
        new = torch.arange(beliefs.strength.shape[-2], device=beliefs.strength.device) >= known
        earlier = beliefs._replace(strength=beliefs.strength.masked_fill(new[:, None], 0.0))
        some = (beliefs.interferers.columns != 0).flatten(-3).any(-1)
        return select(some, left_by(context, earlier, self.dictionary), residual)

    def around(self, objects: Objects) -> Tensor:
        """Cells in the neighbourhood of each object, `(*batch, N, C)` bool."""
        position = self.region.gather(objects.state, objects.log_weight)[..., : self.region.num_coordinates]
        mean = weighted_mean(position.mT, objects.log_weight[..., None, :])
        return neighbourhood(self.dictionary, self.region.cell_of(mean), self.settings)

    def predict(self, intensity: Tensor, model: Model) -> Tensor:
        """The intensity before the data of a step."""
        moves = transition(self.grid, self.region, model, self.step_s, intensity.shape[:-3])
        birth = model.birth.log_odds(
            self.region, self.dictionary.points.expand(*intensity.shape[:-3], -1, -1)
        )
        return predict_intensity(intensity, moves, self.grid, self.region, model.survival, birth)


@torch.no_grad()
def log_ratio(context: StepContext, residual: Unexplained, power: Tensor, share: Tensor) -> Tensor:
    """Log-likelihood ratio of an object in each cell at each level, `(*batch, L, C)`; a constant.

    Args:
        context: model and data.
        residual: what known objects and noise leave unexplained of tempered data.
        power: `(*batch, I, G)` of the tones' levels.
        share: `(L, 1 + G)` of no power, and of each power.
    """
    # The evidence is not tempered.
    q = residual.cells.q / append_dims(context.model.likelihood_power, 2)
    s = residual.cells.s.clamp_min(0)
    return level_log_likelihood(s, q, context.measurement.num_snapshots, power, share)


def doubted(context: StepContext, left: Unexplained, share: float) -> Unexplained:
    """What is left unexplained, were the noise stronger by a share of what the known objects send.

    Noise is that much stronger in all directions but theirs, in which nothing is left anyway.

    Args:
        context: model and data.
        left: what known objects and noise leave unexplained.
        share: of the objects' power.
    """
    present = context.measurement.present
    nothing = present.new_zeros((*present.shape, present.shape[-1]), dtype=present.dtype.to_complex())
    alone = received_power(context.noise.covariance(nothing, left.noise, present))
    ratio = alone / (alone + share * left.received)
    cells = left.cells._replace(s=left.cells.s * ratio[..., None], q=left.cells.q * ratio[..., None] ** 2)
    return left._replace(cells=cells, noise=left.noise / ratio)


def left_by(context: StepContext, beliefs: Beliefs, dictionary: Dictionary) -> Unexplained:
    """What objects and noise leave unexplained of tempered data."""
    measurement = context.measurement.tempered(append_dims(context.model.likelihood_power, 1))
    signal = signal_covariance(beliefs.strength, beliefs.moment)
    noise = beliefs.noise.mean.detach()
    covariance = context.noise.covariance(signal, noise, measurement.present)
    cells = cell_statistics(dictionary, whiten(measurement, covariance))
    return Unexplained(cells, noise, received_power(signal.detach()))


def without(intensity: Tensor, cells: Tensor) -> Tensor:
    """An intensity `(*batch, V, L, C)` with nothing left in cells `(*batch, C)`."""
    return torch.where(cells[..., None, None, :], 0.0, intensity)
