"""What explains the data of a step: objects, noise, and signals that are no objects.

Objects that arrive together are worth less one by one than a signal of free signature that stands for them
all; and a signal that is no object is worth less than the many objects that it is taken for, if each of these
may go alone. Whole explanations are therefore compared where new objects are in question or a new signal is:

- all objects have their say before any is doubted;
- each is doubted from the start, and what new signals explain is gone before objects are looked for again.

That of the larger `free_energy` is kept.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchdt.core.trees import select, tree_map
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.update import free_energy, update
from torchdt.filter.config import TrackerConfig
from torchdt.filter.context import StepContext
from torchdt.filter.interference.settings import NOTHING_ELSE, Interference, beside
from torchdt.filter.placement import Placer
from torchdt.filter.predict import Predicted
from torchdt.filter.proposal.cells import Unexplained
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.filter.proposal.moved import Draws
from torchdt.filter.slots import Placed
from torchdt.model.prior import Priors


class Explanation(NamedTuple):
    """What is believed after the messages of a step.

    Attributes:
        placed: known and new objects on the particles of this step, predicted weights.
        residual: what the known objects leave unexplained, new ones left out.
        beliefs: of objects, noise and interferers.
    """

    placed: Placed
    residual: Unexplained
    beliefs: Beliefs


class Explainer:
    """Explains the data of a step.

    Args:
        context: field, region, model and data; its noise is that of the model.
        dictionary: responses on the region's grid.
        config: settings of the filter.
        predicted: known objects and noise before the data, batch `(*batch, N)`.
        before: `(*batch, I, M, K)` interferers of the last step.
        priors: limits of the priors.
        draws: random numbers of the proposals for known and for new objects, and of refining picks.
    """

    def __init__(
        self,
        context: StepContext,
        dictionary: Dictionary,
        config: TrackerConfig,
        predicted: Predicted,
        before: Tensor,
        priors: Priors,
        draws: tuple[Draws, Draws, Tensor],
    ):
        self.context, self.dictionary, self.config = context, dictionary, config
        self.predicted, self.before, self.priors, self.draws = predicted, before, priors, draws

    def explain(self) -> Explanation:
        """The best explanation."""
        rivals, beliefs = self.config.interference, self.predicted.beliefs
        if not rivals.signatures:
            placed, residual = self._place(beliefs)
            return Explanation(placed, residual, self._update(placed, placed.beliefs, rivals))
        seen = self.context.measurement, self.context.model.noise, beliefs.noise, beliefs.signal
        going_on = rivals.follow(*seen, self.before, new=False)
        placed, residual = self._place(beliefs._replace(interferers=going_on))
        doubted = Explanation(placed, residual, self._update(placed, placed.beliefs, rivals))
        found = doubted.beliefs.interferers
        assert found is not None
        begun = ((found.columns != 0) & (going_on.columns == 0)).flatten(-3).any(-1)
        odds = placed.objects.log_odds
        contested = ((odds < 0) & odds.isfinite()).any(-1) | begun
        if not bool(contested.any()):
            return doubted
        first = self._update(placed, placed.beliefs, NOTHING_ELSE, 1)
        believed = Explanation(placed, residual, self._update(placed, first, rivals))
        if bool(begun.any()):
            placed, residual = self._place(beliefs._replace(interferers=found))
            again = Explanation(placed, residual, self._update(placed, placed.beliefs, rivals))
            doubted, believed, again = _alike(doubted, believed, again)
            doubted = select(begun & self._better(again, doubted), again, doubted)
        # Without a signal that is no object there is nothing to doubt objects for.
        needless = (found.columns == 0).flatten(-3).all(-1)
        return select(contested & (needless | self._better(believed, doubted)), believed, doubted)

    def _place(self, beliefs: Beliefs) -> tuple[Placed, Unexplained]:
        """Objects where the data, less the interferers, want them."""
        context = self.context._replace(noise=beside(self.context.noise, beliefs.interferers))
        predicted = self.predicted._replace(beliefs=beliefs)
        return Placer(context, self.dictionary, self.config).place(predicted, self.priors, *self.draws)

    def _update(
        self, placed: Placed, start: Beliefs, rivals: Interference, sweeps: int | None = None
    ) -> Beliefs:
        """Beliefs after all sweeps, or some."""
        cfg = self.config
        return update(
            placed.objects,
            placed.response,
            self.predicted.beliefs.noise,
            self.context.measurement,
            sweeps=cfg.sweeps if sweeps is None else sweeps,
            schedule=cfg.schedule,
            initial=start,
            noise_model=self.context.noise,
            interference=rivals,
            before=self.before if rivals.signatures else None,
        )

    def _better(self, first: Explanation, second: Explanation) -> Tensor:
        """Where the first explains the data better, `(*batch,)`."""
        value = [
            free_energy(e.beliefs, e.placed.objects, self.context.measurement, self.context.noise)
            for e in (first, second)
        ]
        return value[0] > value[1]


def _alike(*explanations: Explanation) -> list[Explanation]:
    """Explanations of as many slots, empty ones behind."""
    number = max(e.placed.objects.log_odds.shape[-1] for e in explanations)
    return [_padded(e, number - e.placed.objects.log_odds.shape[-1]) for e in explanations]


def _padded(explanation: Explanation, number: int) -> Explanation:
    """An explanation with empty slots behind those that it has."""
    if not number:
        return explanation
    dim = explanation.placed.objects.log_odds.ndim - 1

    def longer(tensor: Tensor) -> Tensor:
        # That of the last slot, which is finite: what an empty one holds means nothing.
        last = tensor.narrow(dim, tensor.shape[dim] - 1, 1)
        return torch.cat([tensor, *[last] * number], dim)

    def empty(log_odds: Tensor) -> Tensor:
        return pad(log_odds, (0, number), value=-torch.inf)

    def widened(beliefs: Beliefs) -> Beliefs:
        objects = tree_map(longer, beliefs.objects)
        diffuse = beliefs.diffuse
        return beliefs._replace(
            objects=objects._replace(log_odds=empty(beliefs.objects.log_odds)),
            moment=longer(beliefs.moment),
            strength=pad(beliefs.strength, (0, 0, 0, number)),
            power=longer(beliefs.power),
            diffuse=None if diffuse is None else longer(diffuse),
        )

    placed = explanation.placed
    objects = tree_map(longer, placed.objects)._replace(log_odds=empty(placed.objects.log_odds))
    return explanation._replace(
        placed=Placed(objects, longer(placed.response), widened(placed.beliefs)),
        beliefs=widened(explanation.beliefs),
    )
