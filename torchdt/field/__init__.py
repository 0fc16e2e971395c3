"""Array responses: the protocol, plane and spherical waves on any array, normal modes in a waveguide."""

from torchdt.field.base import BaseField, Field
from torchdt.field.plane_wave import LineArrayField, PlaneWaveField
from torchdt.field.spherical_wave import SphericalWaveField
from torchdt.field.waveguide.env_file import read_env
from torchdt.field.waveguide.environment import Environment, HalfSpace, Layer, combine_eofs
from torchdt.field.waveguide.modes import ModeSolverError, ModeTable, solve_modes
from torchdt.field.waveguide.waveguide import NormalModeField

__all__ = [
    "BaseField",
    "Environment",
    "Field",
    "HalfSpace",
    "Layer",
    "LineArrayField",
    "ModeSolverError",
    "ModeTable",
    "NormalModeField",
    "PlaneWaveField",
    "SphericalWaveField",
    "combine_eofs",
    "read_env",
    "solve_modes",
]
