"""Birth of new objects that is told where to look: a Poisson process over areas of the region."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.core.ranges import Finite, Positive, check
from torchdt.model.birth import MEAN
from torchdt.model.part import Number, Part, append_dims, number
from torchdt.model.region import Region


@dataclass(frozen=True)
class Area:
    """A box in which objects are born, as likely in one place as in another.

    Attributes:
        low, high: corners, one number for each coordinate.
        weight: of the area beside the others.
    """

    low: list[Finite]
    high: list[Finite]
    weight: Positive = 1.0


@dataclass(frozen=True)
class AreaBirth(Part):
    """New objects come from some areas and from nowhere else.

    Of the mean number each cell has what its share of the areas is worth: in effect areas end at the sides of
    cells. What a region leaves of the areas shares the whole number.

    Attributes:
        birth_mean: mu_B, mean number of new objects per step in all areas together.
        areas: `Area`, or mappings of its fields.
        share: `(C,)` of `birth_mean`, of each cell of the region's grid; what `on` finds.
    """

    KEY: ClassVar[str] = "model.birth"

    birth_mean: Number = number(1e-4, MEAN)
    areas: Sequence[Any] = ()
    share: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)

    def on(self, region: Region) -> Self:
        """The model in a region.

        Raises:
            InputError: where an area does not make sense there, or no cell has a share of one.
        """
        return dataclasses.replace(super().on(region), share=_share(self.areas, region, f"{self.KEY}.areas"))

    def log_odds(self, region: Region, position: Tensor) -> Tensor:
        """`log mu_B w_c`, with w_c the share of the cell that holds the position."""
        assert self.share is not None, "a model of births is used on its region"
        log_mean = torch.log(self.birth_mean)
        return (
            append_dims(log_mean, position.ndim - 1 - log_mean.ndim)
            + self.share.log()[region.cell_of(position)]
        )

    def log_none(self, region: Region, log_odds: Tensor) -> Tensor:
        """`sum_c -log(1 + mu_B w_c)` over the cells that are not looked at."""
        assert self.share is not None, "a model of births is used on its region"
        all_cells = torch.log1p(self.birth_mean[..., None] * self.share).sum(-1)
        return torch.log1p(log_odds.exp()).sum(-1) - all_cells


def _share(areas: Sequence[Any], region: Region, key: str) -> Tensor:
    """Share of each cell in the areas, `(C,)`, of sum one."""
    require(len(areas) > 0, key, "none", "one area or more")
    centre, half = region.cell_centres(), region.cell / 2
    total = torch.zeros_like(centre[:, 0])
    d = region.num_coordinates
    for index, entry in enumerate(areas):
        name = f"{key}[{index}]"
        area = _checked(name, entry)
        for end in ("low", "high"):
            values = getattr(area, end)
            require(len(values) == d, f"{name}.{end}", values, f"one number for each of {d} coordinates")
        low, high = centre.new_tensor(area.low), centre.new_tensor(area.high)
        require(bool((low < high).all()), f"{name}.low", area.low, f"a corner below high, {area.high}")
        ends = torch.minimum(centre + half, high), torch.maximum(centre - half, low)
        overlap = (ends[0] - ends[1]).clamp_min(0.0)
        total = total + area.weight * (overlap / (high - low)).prod(-1)
    total = torch.where(region.is_birth_cell, total, 0.0)
    require(bool(total.sum() > 0), key, "no cell of the region", "a cell in which objects can be, or more")
    return total / total.sum()


def _checked(name: str, area: Any) -> Area:
    if not isinstance(area, Area):
        fields = [f.name for f in dataclasses.fields(Area)]
        known = isinstance(area, Mapping) and {"low", "high"} <= set(area) <= set(fields)
        require(known, name, area, f"values of {fields} by name")
        area = Area(**area)
    check(area, name)
    return area
