"""The numbers of the statistical model as tensors, so that a likelihood can be differentiated in them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.config import TrackerConfig
from torchdt.model.region import Region, per_coordinate


class Parameters(NamedTuple):
    """Numbers of the transition and birth models.

    Each is a real tensor of shape `()`, or `(*batch,)` for a setting of its own per sequence.

    Attributes:
        power_shape: c_gamma, shape of the Gamma transition of the powers.
        noise_shape: c_eta, shape of the Gamma transition of the noise variances.
        survival: p_s, probability to go on existing for one step.
        birth_mean: mu_B, mean number of new objects per step in the whole region.
        driving_variance: `(d,)` or `(*batch, d)`, variance of the driving noise, (unit / s^2)^2.
        likelihood_power: power to which the likelihood is raised in the update.
    """

    power_shape: Tensor
    noise_shape: Tensor
    survival: Tensor
    birth_mean: Tensor
    driving_variance: Tensor
    likelihood_power: Tensor

    def select(self, sequences: slice) -> "Parameters":
        """Numbers of some sequences of a batch `(B,)`; a number that all share stays as it is."""
        shared = {name: int(name == "driving_variance") for name in self._fields}
        return Parameters(
            *(v[sequences] if v.ndim > shared[name] else v for name, v in self._asdict().items())
        )


def widen(value: Tensor, dims: int) -> Tensor:
    """Append dimensions of size one, so that `(*batch,)` broadcasts to `(*batch, ...)`."""
    return value.reshape(*value.shape, *(1 for _ in range(dims)))


def default_parameters(config: TrackerConfig, region: Region) -> Parameters:
    """Numbers of a configuration, in the type and on the device of the region.

    Raises:
        InputError: where `driving_variance` is not one number for each coordinate.
    """
    driving = per_coordinate(config.driving_variance, region.driving_variance, "tracker.driving_variance")
    scalars = {
        name: driving.new_tensor(getattr(config, name))
        for name in Parameters._fields
        if name != "driving_variance"
    }
    return Parameters(**scalars, driving_variance=driving)


def with_values(parameters: Parameters, values: Mapping[str, Tensor]) -> Parameters:
    """Replace the fields that are among the values, in their type and on their device; gradients pass.

    Args:
        parameters: of the filter.
        values: by name, of shapes as in `Parameters`; names that are no field of it are left out.
    """
    named = {name: values[name].to(old) for name, old in parameters._asdict().items() if name in values}
    return parameters._replace(**named)


def stack_parameters(settings: Sequence[Parameters], num_sequences: int) -> Parameters:
    """Several settings for the same sequences, setting by setting.

    Args:
        settings: V of them, each of scalars and `(d,)`.
        num_sequences: B.

    Returns:
        Parameters of batch `(V * B,)`: those of setting v at `v * B` up to `v * B + B - 1`.
    """
    return Parameters(
        *(torch.stack(values).repeat_interleave(num_sequences, 0) for values in zip(*settings, strict=True))
    )
