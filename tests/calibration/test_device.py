"""Calibration does not depend on the defaults of PyTorch."""

from functools import partial

import pytest
import torch
from oracles.devices import default_dtype, foreign_defaults
from oracles.waveguide import configured

from torchdt.calibration import environment
from torchdt.calibration.environment import Calibration, CalibrationConfig, calibrate
from torchdt.field.build import EnvironmentDraw, waveguide
from torchdt.field.waveguide.family import WaveguideFamily
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.model.prior import data_priors
from torchdt.model.region import Coordinate, Region

pytestmark = pytest.mark.slow
F64 = torch.float64


def test_defaults_of_pytorch_have_no_part_in_calibration(scene, monkeypatch):
    """The environment is left for a better one, which is the same to the last bit; ten iterations show it."""
    monkeypatch.setattr(environment, "focalise", partial(environment.focalise, iterations=10))
    keywords = configured(freqs=(49.0, 148.0, 283.0))
    config = CalibrationConfig(enabled=True, steps=2, sources=2, passes=1)

    def solve(draw: EnvironmentDraw) -> NormalModeField:
        return waveguide(**keywords, draw=draw, dtype=F64, device="cpu")

    def fit() -> Calibration:
        coordinates = [
            Coordinate("range", "m", 2000.0, 3500.0, 25.0, -4.0, 4.0, 1e-2),
            Coordinate("depth", "m", 20.0, 80.0, 2.0, -1.0, 1.0, 1e-5),
        ]
        family, region = WaveguideFamily(solve, [1.0, 1.0], 1.0, 1.0), Region(coordinates, F64)
        priors, stream = data_priors(scene.measurement), torch.Generator().manual_seed(0)
        return calibrate(family, region, scene.measurement, priors, config, stream)

    with default_dtype(F64):
        expected = fit()
    with foreign_defaults(F64):
        found = fit()
    torch.testing.assert_close(found, expected, rtol=0, atol=0)
    assert found.theta.ne(0).all()
    assert found.theta.dtype == found.share.dtype == F64
