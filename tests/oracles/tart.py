"""A small file in the format of the radio array TART, with one known source, and covariances of two."""

import numpy as np
import torch

from torchdt.field.plane_wave import PlaneWaveField
from torchdt.model.region import Coordinate, Region

SIZE = 10
"""Sensors of `scene`."""


def sky(num_steps=5, power=0.5, size=6):
    """Arrays of the file, and unit vectors `(4, K, 3)` towards four satellites; the first is heard."""
    rng = np.random.default_rng(0)
    place = np.concatenate([rng.uniform(-0.3, 0.3, (size, 2)), np.zeros((size, 1))], 1)
    step = np.arange(num_steps)
    elevation = np.stack([60 + 0 * step, 5.5 + 3 * step, 50 + 0 * step, -20 + step]).astype(float)
    azimuth = np.stack([30 + step, 100 + step, 200 + step, 300 + step]).astype(float)
    az, el = np.radians(azimuth), np.radians(elevation)
    vectors = np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], -1)
    wave = np.exp(2j * np.pi * 1.5e9 / 299792458.0 * vectors[0] @ place.T)
    pairs = np.stack(np.triu_indices(size, 1), -1)[::-1].astype(np.int16)
    phase = rng.uniform(-3, 3, (num_steps, size))
    first, second = pairs.T
    heard = power * wave[:, first] * wave[:, second].conj()
    arrays = {
        "vis_raw": heard * np.exp(1j * (phase[:, first] - phase[:, second])),
        "baselines": pairs,
        "phase": phase,
        "ant_enu_m": place,
        "freq_hz": np.float64(1.5e9),
        "t_unix": 1.7e9 + 2.0 * step,
        "sat_az_deg": azimuth,
        "sat_el_deg": elevation,
        "sat_isL1": np.array([True, True, False, True]),
    }
    return arrays, vectors


def write_sky(folder, arrays):
    np.savez(folder / "sky.npz", **arrays)
    return folder / "sky.npz"


def scene(standing):
    """Field, region, and covariances `(4, M, M)` of two sources at centres of cells, one of which moves."""
    stream = torch.Generator().manual_seed(0)
    place = torch.rand(SIZE, 3, generator=stream, dtype=torch.float64) * torch.tensor([1.0, 1.0, 0.0])
    field = PlaneWaveField([1.5e9], place.tolist(), 3e8, "direction_cosines", dtype=torch.float64)
    coordinates = [Coordinate(name, "cos", -1, 1, 0.1, -1, 1, 1.0) for name in ("east", "north")]
    region = Region(coordinates, torch.float64).within(field)
    still, moving = torch.tensor([0.35, 0.15]), torch.tensor([[-0.55, 0.05 + 0.1 * k] for k in range(4)])
    position = torch.stack([still.expand(4, 2), moving], 1).double()
    wave = SIZE**0.5 * field(position)[..., 0, :].mT
    sky = wave @ (torch.tensor([0.3, 0.2], dtype=torch.float64)[:, None] * wave.mH)
    return field, region, sky + 0.5 * torch.eye(SIZE) + standing
