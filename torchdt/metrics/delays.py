"""How fast a tracker declares what appears, and drops what disappears."""

from typing import NamedTuple

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from torchdt.filter.history import TrackHistory
from torchdt.model.distance import EUCLIDEAN, Distance, distances


class TrackDelays(NamedTuple):
    """Delays in steps.

    Attributes:
        birth: for each source that is ever present, from its birth to the first estimate assigned to it; its
            lifetime where it is never found.
        drop: for each source that dies while a track has it in its last step, from its death to the end of
            that track; the remaining steps for a track that goes on to the end.
    """

    birth: list[int]
    drop: list[int]


def track_delays(
    history: TrackHistory,
    truth: Tensor,
    cutoff: float,
    order: float = 1.0,
    distance: Distance = EUCLIDEAN,
) -> TrackDelays:
    """Delays of declaring and of dropping.

    Args:
        history: of one run, without batch, on the CPU.
        truth: `(K, L, d)` float64 true positions, NaN while absent; a source is present in one stretch.
        cutoff: distance below which an estimate can be assigned to a source.
        order: of the distances in the assignment.
        distance: of an estimate and a true position.
    """
    present = ~truth.isnan().any(-1)
    owner = torch.zeros_like(present, dtype=torch.int64)  # label of the estimate assigned, 0 = none
    reported = [history.label[k][declared] for k, declared in enumerate(history.declared)]
    for k, labels in enumerate(reported):
        found = history.position[k, history.declared[k]].double()
        apart = distances(truth[k, present[k]], found, distance)
        i, j = linear_sum_assignment(apart.clamp_max(cutoff) ** order)
        near = (apart[i, j] < cutoff).numpy()
        owner[k, present[k].nonzero()[i[near], 0]] = labels[j[near]]

    births, drops = [], []
    for source in range(truth.shape[1]):
        steps = present[:, source].nonzero()[:, 0]
        if not len(steps):
            continue
        owned = owner[steps, source].nonzero()[:, 0]
        births.append(int(owned[0]) if len(owned) else len(steps))
        end = int(steps[-1]) + 1
        label = owner[end - 1, source]
        if end < len(truth) and label > 0:
            lasts = [bool((labels == label).any()) for labels in reported[end:]]
            drops.append(lasts.index(False) if False in lasts else len(lasts))
    return TrackDelays(births, drops)
