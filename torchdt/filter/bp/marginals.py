"""What becomes of the beliefs that the messages of a step leave."""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

from torch.nn.functional import pad

from torchdt.core.random import RandomStreams
from torchdt.core.ranges import Checked, Count, Share
from torchdt.core.trees import put_sequences, select, take_sequences
from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.bp.configurations import UniformDraws
from torchdt.filter.bp.joint import clusters, joint_marginals
from torchdt.filter.context import StepContext
from torchdt.filter.predict import Predicted, exchangeable
from torchdt.filter.slots import Placed


@runtime_checkable
class Marginals(Protocol):
    """Marginals of all objects, from what the messages leave."""

    def draw(self, streams: RandomStreams, slots: int, births: int, num_tones: int) -> Any:
        """Random numbers of one step, always as many."""
        ...

    def refine(
        self, context: StepContext, predicted: Predicted, current: Placed, beliefs: Beliefs, draws: Any
    ) -> Beliefs:
        """The beliefs of a step.

        Args:
            context: field, region, model and data.
            predicted: known objects and noise before the data, batch `(*batch, N)`.
            current: known and new objects on the particles of this step.
            beliefs: that the messages leave.
            draws: see `draw`.
        """
        ...


@dataclass(frozen=True)
class OfMessages:
    """Those of the messages, as in Liang and Meyer."""

    def draw(self, streams: RandomStreams, slots: int, births: int, num_tones: int) -> None:
        """It needs none."""

    def refine(
        self, context: StepContext, predicted: Predicted, current: Placed, beliefs: Beliefs, draws: None
    ) -> Beliefs:
        """The beliefs as they are."""
        return beliefs


@dataclass(frozen=True)
class Joint(Checked):
    """Those of objects that overlap come from joint configurations, see `torchdt.filter.bp.joint`.

    Attributes:
        samples: number S of configurations.
        coherence: of responses, from which on two objects overlap, see `clusters`.
    """

    KEY: ClassVar[str] = "tracker.marginals"

    samples: Count = 64
    coherence: Share = 0.25

    def draw(
        self, streams: RandomStreams, slots: int, births: int, num_tones: int
    ) -> tuple[UniformDraws, int]:
        """Uniform draws for known and new objects, and the number of slots of known ones."""
        return UniformDraws.draw(streams, slots + births, num_tones, self.samples), slots

    def refine(
        self,
        context: StepContext,
        predicted: Predicted,
        current: Placed,
        beliefs: Beliefs,
        draws: tuple[UniformDraws, int],
    ) -> Beliefs:
        """See `joint_marginals`; sequences in which nothing overlaps keep their beliefs."""
        uniform, slots = draws
        known = predicted.objects.log_odds.shape[-1]
        new = current.objects.log_odds.shape[-1] - known
        exchange = pad(exchangeable(predicted, context.region), (0, new, 0, new))
        cluster = clusters(beliefs, self.coherence, exchange)
        rows = cluster.flatten(-2).any(-1)
        if not bool(rows.any()):
            return beliefs

        def refined(context: StepContext, placed: Placed, old: Beliefs, *rest: Any) -> Beliefs:
            cluster, exchange, draws = rest
            return joint_marginals(
                placed.objects,
                placed.response,
                context.measurement,
                old,
                cluster,
                exchange,
                draws,
                context.noise,
            )

        arguments = current, beliefs, cluster, exchange, uniform.pick(known, slots, new)
        if rows.ndim != 1 or bool(rows.all()):
            return select(rows, refined(context, *arguments), beliefs)
        some = rows.nonzero().squeeze(-1)
        again = refined(context.select(some), *take_sequences(arguments, some))
        return put_sequences(beliefs, some, again)
