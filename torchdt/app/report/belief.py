"""Beliefs of any tracker in one form, for histograms and particle clouds."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.baselines.mot.tracker import PointState
from torchdt.core.trees import tree_map
from torchdt.filter.history import StepEstimate
from torchdt.filter.state import TrackerState


class Belief(NamedTuple):
    """Weighted samples of N potential objects after a step.

    Attributes:
        particles: `(N, P, D)` d positions, then what the motion has beside them.
        weight: `(N, P)` of the particles; those of an object sum to one.
        power: `(N, I, G)` support points of each tone's power, in squared units of the data.
        power_weight: `(N, I, G)` of the support points; those of a tone sum to one.
    """

    particles: Tensor
    weight: Tensor
    power: Tensor
    power_weight: Tensor


def belief_of(state: object, estimate: StepEstimate) -> Belief | None:
    """What a tracker's state says about the objects.

    Args:
        state: after a step, of one sequence.
        estimate: of that step, of the same sequence, in units of the data.

    Returns:
        The belief, on the CPU. A tracker of points has no more than one value for a power. None for a state
        of any other type.
    """
    if isinstance(state, TrackerState):
        objects = state.objects
        # The state is in the tracker's own unit of power, which the estimates give away.
        unit = (estimate.power / objects.mean_power).unsqueeze(-1)
        weight = objects.log_weight.exp(), objects.log_power_weight.exp()
        belief = Belief(objects.state, weight[0], objects.power * unit, weight[1])
    elif isinstance(state, PointState):
        power = estimate.power.unsqueeze(-1)
        belief = Belief(
            state.objects.particles, state.objects.log_weight.exp(), power, torch.ones_like(power)
        )
    else:
        return None
    return tree_map(lambda t: t.detach().cpu(), belief)
