"""Where a source over a sloping bottom is seen by one who believes the bottom flat.

In water of depth D the horizontal wavenumber of mode n is about `k - (n pi / D)^2 / (2 k)`. Over a bottom
that rises evenly from D(0) to D(r) the mean of `1 / D^2` is `1 / (D(0) D(r))`, so that each mode has the
phase of the range `r D(0) / D(r)` over a flat bottom, and the value of the depth `z D(0) / D(r)`: the mirage
of D'Spain et al., J. Acoust. Soc. Am. 105, 1999.
"""

import torch
from torch import Tensor

from torchdt.field.base import Field
from torchdt.field.wrapped import WrappedField

_LEAST = 0.2
"""Of the depth at the array, that the water has everywhere: no slope is followed any further."""


class MirageField(WrappedField):
    """A field over a sloping bottom, in the coordinates of one who believes it flat.

    Args:
        field: takes states of range m, depth m, ...
        steepness: slope of the bottom over the water depth at the array, 1/m.
    """

    def __init__(self, field: Field, steepness: Tensor):
        super().__init__(field)
        self.steepness = steepness

    def at(self, state: Tensor) -> Tensor:
        """Where a source is that is seen in a place."""
        return true_position(state, self.steepness)


def true_position(apparent: Tensor, steepness: Tensor) -> Tensor:
    """Where a source is that is seen at `apparent`, `(*batch, D)` of range m, depth m, ..."""
    return _scaled(apparent, 1 / (1 + steepness * apparent[..., :1]).clamp_min(_LEAST))


def apparent_position(position: Tensor, steepness: Tensor) -> Tensor:
    """Where a source at a position `(*batch, D)` of range m, depth m, ... is seen."""
    return _scaled(position, 1 / (1 - steepness * position[..., :1]).clamp_min(_LEAST))


def _scaled(state: Tensor, factor: Tensor) -> Tensor:
    return torch.cat([state[..., :2] * factor, state[..., 2:]], -1)
