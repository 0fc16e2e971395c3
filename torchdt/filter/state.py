"""What the filter carries from step to step: beliefs about objects and noise."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.weights import weighted_mean
from torchdt.model.noise.base import Noise


class Objects(NamedTuple):
    """Beliefs about N potential objects; an empty slot has `log_odds` of minus infinity.

    Attributes:
        state: `(*batch, N, P, D)` particles: d positions, then what the motion has beside them.
        log_weight: `(*batch, N, P)` normalised log-weights.
        power: `(*batch, N, I, G)` support points of each tone's power.
        log_power_weight: `(*batch, N, I, G)` normalised log-weights.
        log_odds: `(*batch, N)` log p(exists) / p(does not).
        label: `(*batch, N)` int64, 0 until the object is first declared.
        transmits: `(*batch, N, P)` probability that the object transmits, given the state of a particle; zero
            or one where messages are computed. All tones together, see
            `torchdt.model.power.base.PowerModel.switch`.
    """

    state: Tensor
    log_weight: Tensor
    power: Tensor
    log_power_weight: Tensor
    log_odds: Tensor
    label: Tensor
    transmits: Tensor

    @property
    def existence(self) -> Tensor:
        """Existence probability r, `(*batch, N)`."""
        return torch.sigmoid(self.log_odds)

    @property
    def mean_power(self) -> Tensor:
        """E[gamma] of each tone given existence, `(*batch, N, I)`."""
        return weighted_mean(self.power, self.log_power_weight)

    @property
    def transmission(self) -> Tensor:
        """Probability that the object transmits in one tone at least, given that it exists, `(*batch, N)`."""
        nothing = torch.where(self.power > 0, 0.0, self.log_power_weight.exp()).sum(-1).prod(-1)
        # One less what is silent: exactly one where nothing is.
        return (1 - weighted_mean(1 - self.transmits, self.log_weight)) * (1 - nothing)


class TrackerState(NamedTuple):
    """Everything a tracker needs to go on.

    Attributes:
        objects: beliefs after the last step.
        noise: predicted for the next step by `DirectTracker`, as after the last one by `PaperTracker`.
        next_label: `(*batch,)` int64, next free label.
        undetected: `(*batch, V, L, C)` intensity of objects of which no potential object is made yet, see
            `torchdt.filter.intensity.intensity`; empty, `(*batch, 0)`, where there is none.
        interference: `(*batch, I, M, K)` complex, interferers of the last step, see
            `torchdt.filter.interference.signatures`; K = 0 where there is no place for them.
    """

    objects: Objects
    noise: Noise
    next_label: Tensor
    undetected: Tensor
    interference: Tensor
