"""Regions that a field refuses: with places that it cannot tell apart, or of periods that are not its own."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.field.base import BaseField, of_each

if TYPE_CHECKING:
    from torchdt.model.region import Region

ROUNDING = 1e-2
"""Relative change of a response that is but the rounding of its phases, in single precision."""

PLACES = 8
"""Places at which a period is tried."""


def refuse_images(region: "Region", field: BaseField) -> None:
    """Refuse a region that holds states and, more than a cell away, others of the same response.

    Whole periods are no distance.

    Raises:
        InputError: naming one such pair.
    """
    if region.low.is_meta:  # no numbers to compare
        return
    centres = of_each(field, region.cell_centres()[region.is_birth_cell])
    for image in field.images(region.complete(centres)):
        apart = (region.difference(image, centres).abs() > 1.01 * region.cell).any(-1)
        twins = (apart & region.contains(image)).nonzero()
        if len(twins):
            here, there = (_in_words(region, position[tuple(twins[0])]) for position in (centres, image))
            found = f"a region that holds both {here} and {there}, which the sensors cannot tell apart"
            raise InputError.of_key("scenario.coordinates", found, "one that holds only one of the two")


def refuse_other_periods(region: "Region", field: BaseField) -> None:
    """Refuse a period after which the response is another one.

    Raises:
        InputError: naming the coordinate.
    """
    if not region.has_period or region.low.is_meta:
        return
    centres = region.cell_centres()[region.is_birth_cell]
    here = region.complete(of_each(field, centres[:: max(1, len(centres) // PLACES)]))
    response = field(here)
    for index, coordinate in enumerate(region.coordinates):
        if coordinate.period is not None:
            there = here.clone()
            there[..., index] += coordinate.period
            change = torch.linalg.vector_norm(field(there) - response)
            same = bool(change <= ROUNDING * torch.linalg.vector_norm(response))
            key = f"scenario.coordinates.{coordinate.name}.period"
            require(same, key, coordinate.period, "one after which the field is the same again, or null")


def _in_words(region: "Region", position: Tensor) -> str:
    values = zip(region.coordinates, position.tolist(), strict=True)
    return ", ".join(f"{c.name} {value:.4g} {c.unit}" for c, value in values)
