"""Steps of a scenario in which not every source can be seen apart."""

import torch
from torch import Tensor

from torchdt.model.distance import distances
from torchdt.simulation.settings import ScenarioSettings


def hidden_steps(scenario: ScenarioSettings, truth: Tensor, separation: float) -> Tensor:
    """Steps in which a source present is silent, or two are nearer to each other than they can be told apart.

    Nothing is excused after a silence or an encounter: the time a tracker takes to recover counts.

    Args:
        scenario: whose sources `truth` holds, in their order.
        truth: `(K, L, d)` true positions, NaN while absent.
        separation: distance, that of the scenario, below which two sources hide each other.

    Returns:
        `(K,)` bool.
    """
    present = ~truth.isnan().any(-1)
    silent = torch.zeros_like(present)
    for index, source in enumerate(scenario.sources.values()):
        for first, last in source.silences:
            silent[first : last + 1, index] = True
    # Distances to absent sources are NaN, which is not below anything; each pair is looked at once.
    close = (distances(truth, truth, scenario.distance) < separation).triu(1)
    return (present & silent).any(-1) | close.any(-1).any(-1)
