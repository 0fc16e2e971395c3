"""Powers of objects that fall silent: a transmit indicator beside existence, for all tones or for each."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchdt.core.support import UNIT
from torchdt.model.part import Number, append_dims, number
from torchdt.model.power.base import Switch
from torchdt.model.power.gamma import GammaPower

FALLS_SILENT, RESUMES = 0.005, 0.2
"""Per step, unless told otherwise: two hundred steps between silences, of five steps each."""


@dataclass(frozen=True)
class SwitchedPower(GammaPower):
    """All tones of an object are sent together or not at all: a Markov chain of two states.

    A silent object is there and says nothing: the data tell neither its state nor its powers, which go on as
    predicted. What is new transmits.

    Attributes:
        falls_silent: probability that an object that transmits is silent in the next step.
        resumes: probability that one that is silent transmits in the next step.
    """

    falls_silent: Number = number(FALLS_SILENT, UNIT)
    resumes: Number = number(RESUMES, UNIT)

    @property
    def switch(self) -> Switch | None:
        """The chain."""
        return Switch(self.falls_silent, self.resumes)


@dataclass(frozen=True)
class SwitchedTones(GammaPower):
    """Each tone of an object is sent or not, whatever the others do: a Markov chain of two states for each.

    The belief about a power has twice the support points asked for: those of a tone that is sent, and as many
    zeros. A zero has the weight of the level that would be sent, which goes on as a Gamma chain.

    Attributes:
        falls_silent: probability that a tone that is sent is not in the next step.
        resumes: probability that one that is not sent is in the next step.
    """

    falls_silent: Number = number(FALLS_SILENT, UNIT)
    resumes: Number = number(RESUMES, UNIT)

    def initial(self, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The uniform prior of a tone that is sent as often as the chain is on in the long run."""
        return self._stationary(*super().initial(maximum, num_points))

    def newborn(self, scale: Tensor, maximum: Tensor, num_points: int) -> tuple[Tensor, Tensor]:
        """The same, its points where a likelihood lies."""
        return self._stationary(*super().newborn(scale, maximum, num_points))

    def _stationary(self, power: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
        total = self.falls_silent + self.resumes
        on, off = (
            append_dims((rate / total).log(), log_weight.ndim - rate.ndim)
            for rate in (self.resumes, self.falls_silent)
        )
        return torch.cat([power, torch.zeros_like(power)], -1), torch.cat(
            [log_weight + on, log_weight + off], -1
        )

    def predict(self, power: Tensor, log_weight: Tensor) -> tuple[Tensor, Tensor]:
        """One Gamma transition of the level, sent or not, and one of the chain.

        The level is known as well whether the tone is sent or not: its belief is that of both together.
        """
        level = power[..., : power.shape[-1] // 2]
        on, off = log_weight.chunk(2, -1)
        level, log_level_weight = super().predict(level, torch.logaddexp(on, off))
        sent = Switch(self.falls_silent, self.resumes).predict(on.exp().sum(-1))[..., None]
        halves = [log_level_weight + sent.log(), log_level_weight + torch.log1p(-sent)]
        return torch.cat([level, torch.zeros_like(level)], -1), torch.cat(halves, -1)
