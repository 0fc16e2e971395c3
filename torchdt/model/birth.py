"""Birth of new objects: a Poisson process over the cells of the region (Liang and Meyer, Sec. II-B)."""

from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, runtime_checkable

import torch
from torch import Tensor
from torch.distributions import constraints

from torchdt.core.ranges import TINY, Range
from torchdt.core.support import Support
from torchdt.model.part import Number, Part, append_dims, number
from torchdt.model.region import Region

MEAN = Support(Range("a positive number", low=0, open_low=True, least=TINY, most=1e4), constraints.positive)
"""Of a mean number of objects that a step brings."""


@runtime_checkable
class Birth(Protocol):
    """Where new objects begin, and with what odds."""

    def log_odds(self, region: Region, position: Tensor) -> Tensor:
        """Log-odds of a new object in one cell around positions; minus infinity where nothing is born.

        Args:
            region: region of interest.
            position: `(*batch, ..., d)`.

        Returns:
            `(*batch, ...)`: the density of new objects, times the volume of a cell.
        """
        ...

    def log_none(self, region: Region, log_odds: Tensor) -> Tensor:
        """Log-probability that nothing is born in the cells that are not looked at, `(*batch,)`.

        Args:
            region: region of interest.
            log_odds: `(*batch, Q)` in the cells in which a new object is considered; minus infinity for none.
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

    def log_odds(self, region: Region, position: Tensor) -> Tensor:
        """`p = mu / (mu + 1)` with `mu = mu_B / Q`, so `log mu`."""
        log_mean = torch.log(self.birth_mean / region.num_cells)
        return append_dims(log_mean, position.ndim - 1 - log_mean.ndim).expand(position.shape[:-1])

    def log_none(self, region: Region, log_odds: Tensor) -> Tensor:
        """`-(Q - n) log(1 + mu)`, with n the number of cells that are looked at."""
        cells = region.num_cells
        return (log_odds.isfinite().sum(-1) - cells) * torch.log1p(self.birth_mean / cells)
