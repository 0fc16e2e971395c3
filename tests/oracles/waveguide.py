"""A small waveguide: 100 m of water, 2 tones, a vertical array of 11 sensors; and the configured one."""

from pathlib import Path
from typing import Any

import torch
import torchdt.conf
from omegaconf import OmegaConf
from torch import Tensor

from torchdt.field import Environment, HalfSpace, Layer
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.model.region import Coordinate, Region

FREQS, DEPTHS = (49.0, 148.0), tuple(10.0 + 8.0 * m for m in range(11))
WATER = Environment(
    profile=((0.0, 1500.0), (100.0, 1490.0)),
    layers=(Layer(bottom=150.0, speed_top=1600.0, speed_bottom=1650.0, density=1.8, attenuation=0.2),),
    halfspace=HalfSpace(speed=1800.0, density=2.0, attenuation=0.1),
)
ENV_FILE = Path(__file__).with_name("coast.env")
COORDINATES = (
    Coordinate("range", "m", 2700.0, 3100.0, 25.0, -4.0, 4.0, 1e-2),
    Coordinate("depth", "m", 20.0, 80.0, 4.0, -1.0, 1.0, 1e-5),
)


def make_field(dtype: torch.dtype, device: str = "cpu", tilt: float | Tensor = 0.0) -> NormalModeField:
    return NormalModeField(WATER, FREQS, DEPTHS, tilt, dtype=dtype, device=device)


def make_region(dtype: torch.dtype, device: str = "cpu") -> Region:
    """16 x 15 cells."""
    return Region(COORDINATES, dtype, device)


def configured(**changes: Any) -> dict[str, Any]:
    """Keywords of `torchdt.field.build.waveguide` as `field=swellex96` has them, but for the changes."""
    keywords = OmegaConf.to_container(
        OmegaConf.load(Path(torchdt.conf.__file__).parent / "field/swellex96.yaml")
    )
    del keywords["_target_"]
    return keywords | changes
