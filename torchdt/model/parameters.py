"""The numbers of the statistical model as tensors, so that a likelihood can be differentiated in them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.filter.config import TrackerConfig
from torchdt.model.gamma_chain import LEAST_SHAPE
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
        effective_count: J that every sample covariance counts as, in update and evidence; None leaves it to
            the data, see `torchdt.model.wishart`.
    """

    power_shape: Tensor
    noise_shape: Tensor
    survival: Tensor
    birth_mean: Tensor
    driving_variance: Tensor
    likelihood_power: Tensor
    effective_count: Tensor | None = None

    def known(self) -> dict[str, Tensor]:
        """Those that have a value, by name."""
        return {name: value for name, value in self._asdict().items() if value is not None}

    def select(self, sequences: slice) -> "Parameters":
        """Numbers of some sequences of a batch `(B,)`; a number that all share stays as it is."""
        shared = {name: int(name == "driving_variance") for name in self._fields}
        return Parameters(
            **{name: v[sequences] if v.ndim > shared[name] else v for name, v in self.known().items()}
        )


def widen(value: Tensor, dims: int) -> Tensor:
    """Append dimensions of size one, so that `(*batch,)` broadcasts to `(*batch, ...)`."""
    return value.reshape(*value.shape, *(1 for _ in range(dims)))


def checked(parameters: Parameters) -> Parameters:
    """The same parameters.

    Raises:
        InputError: where the shape of a Gamma transition is below `LEAST_SHAPE`.
    """
    for name in ("power_shape", "noise_shape"):
        shape = getattr(parameters, name)
        if shape.is_meta:  # no numbers to check
            continue
        smallest = shape.min().item()
        require(smallest >= LEAST_SHAPE, name, f"{smallest:g}", f"a number of at least {LEAST_SHAPE:g}")
    return parameters


def default_parameters(config: TrackerConfig, region: Region) -> Parameters:
    """Numbers of a configuration, in the type and on the device of the region.

    Raises:
        InputError: where `driving_variance` is not one number for each coordinate.
    """
    driving = per_coordinate(config.driving_variance, region.driving_variance, "tracker.driving_variance")
    numbers = {name: getattr(config, name) for name in Parameters._fields if name != "driving_variance"}
    scalars: dict[str, Any] = {
        name: None if value is None else driving.new_tensor(value) for name, value in numbers.items()
    }
    return Parameters(**scalars, driving_variance=driving)


def with_values(parameters: Parameters, values: Mapping[str, Tensor]) -> Parameters:
    """Replace the fields that are among the values, in their type and on their device; gradients pass.

    Args:
        parameters: of the filter.
        values: by name, of shapes as in `Parameters`; names that are no field of it are left out.
    """
    like = parameters.survival
    return parameters._replace(**{n: values[n].to(like) for n in Parameters._fields if n in values})


def stack_parameters(settings: Sequence[Parameters], num_sequences: int) -> Parameters:
    """Several settings for the same sequences, setting by setting.

    Args:
        settings: V of them, each of scalars and `(d,)`.
        num_sequences: B.

    Returns:
        Parameters of batch `(V * B,)`: those of setting v at `v * B` up to `v * B + B - 1`.

    Raises:
        InputError: where some settings have an `effective_count` and others leave it to the data.
    """
    stacked = []
    for name, values in zip(Parameters._fields, zip(*settings, strict=True), strict=True):
        known = [value for value in values if value is not None]
        found = f"{len(known)} of {len(values)} settings with a value"
        require(len(known) in (0, len(values)), name, found, "one in each or in none")
        stacked.append(torch.stack(known).repeat_interleave(num_sequences, 0) if known else None)
    return Parameters._make(stacked)
