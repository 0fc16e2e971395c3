"""Recordings of the radio array TART as `.npz` files of visibilities with the satellites' true directions.

The array looks at the whole sky in one narrow band (T. Molteno and T. Hugo, tart-telescope/radio-imaging).
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchdt.core.errors import InputError, require
from torchdt.data.npz import open_archive, open_file, read_tensor
from torchdt.data.recording import Recording, validate

LOWEST = 10.0
"""Elevation in degrees from which satellites count: below it, elements hear little of them."""

SHAPES = {
    "vis_raw": "KB",
    "baselines": "B2",
    "ant_enu_m": "M3",
    "phase": "KM",
    "freq_hz": "",
    "t_unix": "K",
    "sat_az_deg": "LK",
    "sat_el_deg": "LK",
    "sat_isL1": "L",
}
"""Keys that are read: K visibilities in time, B pairs of M antennas, L satellites."""


def read_tart(path: str | os.PathLike[str], average: int = 10, num_snapshots: float = 1.0) -> Recording:
    """Read one file.

    The phase of a visibility is set right by those of its two antennas,
    `R_pq = V_pq exp(-i (phase_p - phase_q))`, `R_pp = 1`: powers are shares of that of a sensor.

    Args:
        path: the file; its stem becomes the name of the recording.
        average: number of consecutive covariances that make one step; what is left at the end is dropped.
        num_snapshots: J that each step is to count as.

    Returns:
        The recording, its time that of `t_unix`: `covariance` `(1, K, 1, M, M)`; positions of the sensors to
        the east, north and up, m; and as `truth` `(1, K, L, 2)` the direction cosines, to the east and to the
        north, of the satellites that send in the band, NaN where one is below `LOWEST`.

    Raises:
        InputError: no such file, not a complete `.npz`, or a key that is missing or does not fit.
    """
    path = Path(path)
    with open_file(path) as file, open_archive(path, file) as archive, _named(path):
        arrays = {key: read_tensor(key, archive) for key in SHAPES if key in archive.files}
        _check(arrays)
        num = len(arrays["vis_raw"]) // max(average, 1)
        require(average >= 1 and num > 0, "average", average, f"1 to {len(arrays['vis_raw'])} covariances")
        times = arrays["t_unix"].double()
        require(len(times) > 1, "t_unix", "one time", "two or more, a step apart")
        covariance = _steps(_covariance(arrays), average)
        interval = (times[-1] - times[0]) / (len(times) - 1)
        return validate(
            covariance=covariance[None, :, None],
            num_snapshots=num_snapshots,
            step_s=average * interval,
            start_s=times[0],
            span_s=(average - 1) * interval,
            freqs=arrays["freq_hz"][None],
            sensor_positions=arrays["ant_enu_m"],
            truth=_truth(arrays, average)[None],
            name=path.stem,
        )


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Errors of a key name the file that it is in."""
    try:
        yield
    except InputError as error:
        raise InputError(f"path '{path}': {error}") from error


def _check(arrays: dict[str, Tensor]) -> None:
    """Missing keys, and sizes that contradict each other."""
    sizes = {"2": 2, "3": 3}
    for key, names in SHAPES.items():
        require(key in arrays, key, "nothing", "an array of a TART recording")
        shape = tuple(arrays[key].shape)
        fits = len(shape) == len(names) and all(
            sizes.setdefault(name, size) == size for name, size in zip(names, shape, strict=True)
        )
        expected = tuple(sizes.get(name, name) for name in names)
        require(fits, key, f"shape {shape}", f"shape {expected}")
    require(arrays["vis_raw"].is_complex(), "vis_raw", arrays["vis_raw"].dtype, "complex numbers")
    pairs = arrays["baselines"].long()
    known = bool(((pairs >= 0) & (pairs < sizes["M"])).all())
    require(known, "baselines", "an antenna that there is not", f"numbers from 0 to {sizes['M'] - 1}")


def _covariance(arrays: dict[str, Tensor]) -> Tensor:
    """`(K, M, M)` complex128."""
    first, second = arrays["baselines"].long().unbind(-1)
    phase = arrays["phase"].double()
    size = phase.shape[-1]
    turned = arrays["vis_raw"].to(torch.complex128) * torch.exp(-1j * (phase[:, first] - phase[:, second]))
    covariance = torch.eye(size, dtype=torch.complex128).repeat(len(phase), 1, 1)
    covariance[:, first, second] = turned
    covariance[:, second, first] = turned.conj()
    return covariance


def _truth(arrays: dict[str, Tensor], average: int) -> Tensor:
    """`(K, L, 2)`, of the satellites that are up at some time."""
    shared = arrays["sat_isL1"].bool()
    azimuth, elevation = (
        torch.deg2rad(arrays[key][shared].double().T) for key in ("sat_az_deg", "sat_el_deg")
    )
    level = elevation.cos()
    towards = torch.stack([level * azimuth.sin(), level * azimuth.cos(), elevation.sin()], -1)
    towards = normalize(_steps(towards, average), dim=-1)
    up = towards[..., 2] > np.sin(np.radians(LOWEST))
    return torch.where(up[..., None], towards[..., :2], torch.nan)[:, up.any(0)]


def _steps(values: Tensor, average: int) -> Tensor:
    """Means of `average` consecutive ones of the K first."""
    num = len(values) // average
    return values[: num * average].unflatten(0, (num, average)).mean(1)
