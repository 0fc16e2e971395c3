"""What a tracker says about one step, and about a whole recording."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import torch
from torch import Tensor

from torchdt.core.trees import stack, tree_map


class Estimates(NamedTuple):
    """Beliefs about N potential objects: what `StepEstimate` and `TrackHistory` have in common.

    A state is d positions, then what the motion has beside them. Values of slots that hold no object are
    finite but meaningless: read them only where `declared` is true or `label` is positive.

    Attributes:
        existence: `(*batch, N)` probability that the object exists.
        transmission: `(*batch, N)` probability that it transmits in one tone at least, given that it exists.
        declared: `(*batch, N)` bool, the object is reported.
        label: `(*batch, N)` int64, identity of the track in the slot; 0 = none yet.
        position: `(*batch, N, d)` the first entries of the state.
        state: `(*batch, N, D)` minimum mean-square error (MMSE) estimates given existence.
        state_std: `(*batch, N, D)` standard deviations of the state given existence, in its units.
        power: `(*batch, N, I)` MMSE transmit power per tone, in squared units of the data.
        noise: `(*batch, I)` MMSE noise variance per tone, in squared units of the data.
        shares: `(*batch, I, 4)` of each tone's energy: objects, interferers, noise, unexplained; zero without
            data, or where the tracker does not know. See `torchdt.filter.shares`.
        effective_sample_size: `(*batch, N)` of the state particles, in particles.
        failed: `(*batch,)` bool, the tracker broke down and the step counts as missing.
        log_evidence: `(*batch,)` log p(z_k | z_1..k-1), natural logarithm.
    """

    existence: Tensor
    transmission: Tensor
    declared: Tensor
    label: Tensor
    position: Tensor
    state: Tensor
    state_std: Tensor
    power: Tensor
    noise: Tensor
    shares: Tensor
    effective_sample_size: Tensor
    failed: Tensor
    log_evidence: Tensor

    def select(self, sequence: int) -> Self:
        """One element of the leading batch dimension, which goes."""
        return tree_map(lambda field: field[sequence], self)


class StepEstimate(Estimates):
    """Beliefs after one step, one for each sequence: see `Estimates`."""

    __slots__ = ()


class TrackHistory(Estimates):
    """Beliefs after each of K steps, batch `(*batch, K)`, such as `existence` of shape `(*batch, K, N)`.

    See `Estimates`.
    """

    __slots__ = ()

    @classmethod
    def of_steps(cls, steps: Sequence[StepEstimate], batch_dims: int) -> Self:
        """Steps in order, of as many batch dimensions, behind which comes that of time."""
        return cls(*stack(steps, batch_dims))

    def steps(self, batch_dims: int) -> list[StepEstimate]:
        """The inverse of `of_steps`."""
        return [StepEstimate(*step) for step in zip(*(t.unbind(batch_dims) for t in self), strict=True)]


def history_like(
    batch: int, steps: int, slots: int, dims: int, entries: int, tones: int, dtype: torch.dtype
) -> TrackHistory:
    """A history of these sizes whose values mean nothing, on the device `meta`, which holds none.

    Args:
        batch: number B of sequences.
        steps: number K of steps.
        slots: number N of potential objects.
        dims: number d of coordinates.
        entries: number D of state entries.
        tones: number I.
        dtype: real type of all that is neither a label nor a decision.
    """
    of_slot: tuple[int, ...] = (batch, steps, slots)
    shapes = {"state": (*of_slot, entries), "state_std": (*of_slot, entries), "power": (*of_slot, tones)}
    shapes |= {
        "position": (*of_slot, dims),
        "noise": (*of_slot[:2], tones),
        "shares": (*of_slot[:2], tones, 4),
        "log_evidence": of_slot[:2],
        "failed": of_slot[:2],
    }
    types = {"declared": torch.bool, "label": torch.int64, "failed": torch.bool}
    return TrackHistory(
        *(
            torch.empty(shapes.get(name, of_slot), dtype=types.get(name, dtype), device="meta")
            for name in TrackHistory._fields
        )
    )
