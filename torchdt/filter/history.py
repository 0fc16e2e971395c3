"""What a tracker returns for a whole recording."""

from typing import NamedTuple

import torch
from torch import Tensor


class TrackHistory(NamedTuple):
    """Beliefs about N potential objects over K steps.

    A state is d positions, then what the motion has beside them. Values of slots that hold no object are
    finite but meaningless: read them only where `declared` is true or `label` is positive.

    Attributes:
        existence: `(*batch, K, N)` probability that the object exists.
        declared: `(*batch, K, N)` bool, the object is reported.
        label: `(*batch, K, N)` int64, identity of the track in the slot; 0 = none yet.
        position: `(*batch, K, N, d)` the first entries of the state.
        state: `(*batch, K, N, D)` minimum mean-square error (MMSE) estimates given existence.
        state_std: `(*batch, K, N, D)` standard deviations of the state given existence, in its units.
        power: `(*batch, K, N, I)` MMSE transmit power per tone, in squared units of the data.
        noise: `(*batch, K, I)` MMSE noise variance per tone, in squared units of the data.
        effective_sample_size: `(*batch, K, N)` of the state particles, in particles.
        failed: `(*batch, K)` bool, the tracker broke down and the step counts as missing.
        log_evidence: `(*batch, K)` log p(z_k | z_1..k-1), natural logarithm.
    """

    existence: Tensor
    declared: Tensor
    label: Tensor
    position: Tensor
    state: Tensor
    state_std: Tensor
    power: Tensor
    noise: Tensor
    effective_sample_size: Tensor
    failed: Tensor
    log_evidence: Tensor

    def select(self, run: int) -> "TrackHistory":
        """One element of the leading batch dimension, `(K, ...)` for a batch `(B, K, ...)`."""
        return TrackHistory(*(field[run] for field in self))


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
