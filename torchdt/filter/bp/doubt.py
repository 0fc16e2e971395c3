"""How much what an object explains speaks for it, where it may be no object.

The odds that a message leaves compare the data with the object and without it. Something else may stand
for it: signals of free signature, or an echo of a stronger object; and with it there, its own response may
leave something. The odds compare all that is with it and all that is without it, each at its best.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.filter.bp.rank_one import Whitener
from torchdt.filter.interference.settings import Interference
from torchdt.filter.interference.signatures import Interferers
from torchdt.model.measurement import Measurement

NOTHING = 1e-3
"""Nats that change no existence."""


class Doubted(NamedTuple):
    """Objects that are in question, one for each element of `(*batch,)`, and the data.

    Attributes:
        measurement: statistics of the step.
        others: `(*batch, I, M, M)` what the object was tested against.
        whitener: of that.
        together: `(*batch, I, M, M)` the same with the object there.
        variance: E[eta], `(*batch, I)`.
        interferers: those that are part of both; None for none.
        slot: `(*batch,)` int64, of the object among all.
        new: `(*batch,)` bool, whether it was improbable before the step.
        moment: `(*batch, N, I, M, M)` complex `E[a a^H]` of all objects, without diffuse parts.
        strength: `(*batch, N, I)` of all, `r E[gamma]`.
        own_moment, own_power: `(*batch, I, M, M)` and `(*batch, I)` of the object itself.
    """

    measurement: Measurement
    others: Tensor
    whitener: Whitener
    together: Tensor
    variance: Tensor
    interferers: Interferers | None
    slot: Tensor
    new: Tensor
    moment: Tensor
    strength: Tensor
    own_moment: Tensor
    own_power: Tensor


def doubt(of: Doubted, interference: Interference) -> Tensor:
    """Change of the log-odds of existence, `(*batch,)`; a constant to any gradient.

    Args:
        of: the objects and the data.
        interference: what may be heard beside objects.
    """
    seen = of.variance, of.interferers
    without_it = torch.maximum(
        interference.rival(of.measurement, of.others, *seen),
        interference.echo(of.whitener, of.slot, of.moment, of.strength, of.new),
    )
    in_question = without_it > NOTHING
    if not bool(in_question.any()):
        return torch.zeros_like(without_it)
    with_it = torch.maximum(
        interference.rival(of.measurement, of.together, *seen),
        interference.leftover(of.measurement, of.others, of.own_moment, of.own_power),
    )
    return torch.where(in_question, with_it - without_it, 0.0)
