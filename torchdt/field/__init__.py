"""Array responses: the protocol, plane waves on a line array, normal modes in a waveguide."""

from torchdt.field.base import Field
from torchdt.field.environment import Environment, HalfSpace, Layer, combine_eofs
from torchdt.field.modes import ModeSolverError, ModeTable, solve_modes
from torchdt.field.plane_wave import LineArrayField
from torchdt.field.waveguide import NormalModeField

__all__ = [
    "Environment",
    "Field",
    "HalfSpace",
    "Layer",
    "LineArrayField",
    "ModeSolverError",
    "ModeTable",
    "NormalModeField",
    "combine_eofs",
    "solve_modes",
]
