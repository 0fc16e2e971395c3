"""Fields by those hyperparameters that concern the array response."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from torchdt.field.base import Field
from torchdt.field.mismatch import MismatchedField
from torchdt.field.waveguide.family import ENVIRONMENT, WaveguideFamily

FieldOf = Callable[[Mapping[str, Tensor]], Field]


def environment_fields(family: WaveguideFamily, start: Mapping[str, Tensor]) -> FieldOf:
    """Waveguides by departures from the nominal environment, linearised at the start.

    Args:
        family: of waveguides.
        start: all of `ENVIRONMENT` by name, `(E,)`, `()` and `()`; it stands for what is left out later.
    """
    device = family.prior_std.device

    def theta(values: Mapping[str, Tensor]) -> Tensor:
        parts = [values.get(name, start[name]) for name in ENVIRONMENT]
        return torch.cat([part.to(device, torch.float64).reshape(-1) for part in parts])

    linear = family.linearise(theta(start))
    return lambda values: linear(theta(values))


def share_fields(field_of: FieldOf, like: Tensor) -> FieldOf:
    """The same fields, of which `mismatch_share` `(I,)` is not where the model says.

    Args:
        field_of: modelled responses, which know themselves without phases (`BaseField.incoherent`).
        like: gives the share's type and device.
    """
    return lambda values: MismatchedField(field_of(values), values["mismatch_share"].to(like))
