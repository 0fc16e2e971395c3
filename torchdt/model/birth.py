"""Birth of new objects: a Poisson process over the cells of the region (Liang and Meyer, Sec. II-B)."""

from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, runtime_checkable

import torch
from torch import Tensor
from torch.distributions import constraints

from torchdt.core.ranges import TINY, Range
from torchdt.core.support import Support
from torchdt.model.part import Number, Part, number
from torchdt.model.region import Region

MEAN = Support(Range("a positive number", low=0, open_low=True, least=TINY, most=1e4), constraints.positive)
"""Of a mean number of objects that a step brings."""


@runtime_checkable
class Birth(Protocol):
    """Where new objects begin, and with what odds."""

    def log_odds(self, region: Region) -> Tensor:
        """Log-odds of a new object in one cell of the region, `(*batch,)`."""
        ...

    def log_none(self, region: Region, num_considered: Tensor) -> Tensor:
        """Log-probability that nothing is born in the cells that are not looked at.

        Args:
            region: region of interest.
            num_considered: `(*batch,)` number of cells in which a new object is considered.
        """
        ...

    def on(self, region: Region) -> Self:
        """The model with numbers in the type and on the device of a region."""
        ...

    def select(self, sequences: slice | list[int]) -> Self:
        """The model of some sequences of a batch."""
        ...


@dataclass(frozen=True)
class UniformBirth(Part):
    """New objects are as likely in one cell as in another.

    Attributes:
        birth_mean: mu_B, mean number of new objects per step in the whole region.
    """

    KEY: ClassVar[str] = "model.birth"

    birth_mean: Number = number(1e-4, MEAN)

    def log_odds(self, region: Region) -> Tensor:
        """`p = mu / (mu + 1)` with `mu = mu_B / Q`, so `log mu`."""
        return torch.log(self.birth_mean / region.num_cells)

    def log_none(self, region: Region, num_considered: Tensor) -> Tensor:
        """`-(Q - n) log(1 + mu)`, with n the number of cells that are looked at."""
        cells = region.num_cells
        return (num_considered - cells) * torch.log1p(self.birth_mean / cells)
