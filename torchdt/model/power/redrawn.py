"""Powers redrawn in every step, as those of a fluctuating target (Swerling, IRE Trans. IT-6, 1960)."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchdt.core.support import UP_TO_ONE
from torchdt.model.part import Number, Part, append_dims, number
from torchdt.model.power.base import Switch

LOWEST, HIGHEST = 1e-4, 10.0
"""Powers over their mean between which support points are spread; a power lies below with a
probability of 1e-4: there twenty snapshots at 20 dB cannot tell it from zero. It lies above with 5e-5."""


@dataclass(frozen=True)
class RedrawnPower(Part):
    """Each tone's power is exponential, `f(gamma) = exp(-gamma / g) / g`, whatever it was one step before.

    Support points stay where they are: each is the mean of a bin, and weighs what the density has there.

    Attributes:
        mean_share: mean g of the density over the largest power of the prior (`tracker.power_max`).
    """

    KEY: ClassVar[str] = "model.power"

    mean_share: Number = number(0.25, UP_TO_ONE)

    @property
    def switch(self) -> Switch | None:
        """Objects transmit in every step."""
        return None

    def initial(self, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The density in bins evenly spaced in the logarithm, an open one at each end."""
        point, log_weight = _bins(num_points, maximum)
        mean = append_dims(self.mean_share, maximum.ndim - self.mean_share.ndim) * maximum
        points = mean[..., None] * point
        return points, log_weight.expand_as(points)

    def newborn(self, scale: Tensor, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The same, wherever the likelihood lies: the next step will have another."""
        return self.initial(maximum, num_points)

    def predict(self, power: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
        """The density again."""
        return power, _bins(power.shape[-1], power)[1].expand_as(power)

    def level_transition(self, level: Tensor) -> Tensor:
        """Any level as likely as another, whatever it was."""
        return torch.full((len(level), len(level)), 1 / len(level), dtype=level.dtype, device=level.device)


def _bins(num_points: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """Means and log-probabilities `(G,)` of bins of the exponential density of mean one."""
    inner = torch.logspace(0, 1, num_points - 1, base=HIGHEST / LOWEST, dtype=like.dtype, device=like.device)
    inner = LOWEST * inner
    low = torch.cat([inner.new_zeros(1), inner])
    # Of the width w of a bin: its probability exp(-a) (1 - exp(-w)), its mean a + 1 - w / (exp(w) - 1).
    width = inner.diff(prepend=inner.new_zeros(1))
    log_weight = torch.cat([(-torch.expm1(-width)).log() - low[:-1], -low[-1:]])
    return torch.cat([low[:-1] + 1 - width / torch.expm1(width), low[-1:] + 1]), log_weight
