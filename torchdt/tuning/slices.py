"""The likelihood along each hyperparameter."""

from typing import NamedTuple

import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from torchdt.model.hyperparameters import Hyperparameters
from torchdt.tuning.objective import Objective, value_of
from torchdt.tuning.state import numbers


class Slice(NamedTuple):
    """The objective where one number changes and all others stay.

    Attributes:
        name: of the hyperparameter; entry n of a vector is `name_n`, counted from one.
        values: of the number, constrained, rising.
        objective: at each of them; NaN where it is not finite.
        centre: value of the number where the slices cross.
    """

    name: str
    values: list[float]
    objective: list[float]
    centre: float


def slices(hyperparameters: Hyperparameters, objective: Objective, width: float, points: int) -> list[Slice]:
    """Evaluate the objective along each trainable number, without gradient.

    Args:
        hyperparameters: where the slices cross; given back as it was.
        objective: what to evaluate, `points` times for each number.
        width: half the length of a slice, in unconstrained units.
        points: of each slice, evenly spread over the unconstrained values.
    """
    centre = parameters_to_vector(hyperparameters.parameters()).detach()
    middle, found = _trainable(hyperparameters), []
    for index, name in enumerate(middle):
        values, heights = [], []
        for offset in torch.linspace(-width, width, points).tolist():
            moved = centre.clone()
            moved[index] += offset
            vector_to_parameters(moved, hyperparameters.parameters())
            height = value_of(objective, hyperparameters)
            heights.append(torch.nan if height is None else height)
            values.append(_trainable(hyperparameters)[name])
        found.append(Slice(name, values, heights, middle[name]))
    vector_to_parameters(centre, hyperparameters.parameters())
    return found


def _trainable(hyperparameters: Hyperparameters) -> dict[str, float]:
    values = hyperparameters.values()
    return numbers({name: values[name] for name in hyperparameters.trainable_names})
