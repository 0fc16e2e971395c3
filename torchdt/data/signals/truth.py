"""True positions from a table over time."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.core.files import regular_file

TABLE = "a table of numbers (.csv)"


def read_truth(path: Path, coordinates: Sequence[str], times: Tensor, depth_m: float | None = None) -> Tensor:
    """Positions of a `.csv` file at the times of the steps, on straight lines between its rows.

    The first row names the columns. Either the first is `time_s`, seconds since the start of the recording,
    and the others are `NAME_COORDINATE`, one for each object and coordinate; or the first begins with
    `minute`, and the second with `range` and ends with `km`: the range of one object, as the SWellEx-96
    tables have it. An empty cell is an absent object, and so is all before the first row and after the last.

    Args:
        path: of the table.
        coordinates: names of the d coordinates of the scenario.
        times: `(K,)` float64, seconds since the start of the recording.
        depth_m: depth that goes with a table of ranges.

    Returns:
        `(K, L, d)` float64, NaN = absent; objects in the order in which the table names them.

    Raises:
        InputError: where the file cannot be read, or header, numbers or times do not fit.
    """
    header, table = _table(path)
    if header[0].startswith("minute"):
        seconds, position = _range_table(header, table, coordinates, depth_m)
    else:
        seconds, position = table[:, 0], _object_table(header, table, coordinates)
    rising = len(seconds) > 0 and bool((np.diff(seconds) > 0).all()) and not np.isnan(seconds).any()
    require(rising, "data.truth", f"'{path}': times that do not rise", "rows in the order of time")
    flat = position.reshape(len(position), -1)
    at = [np.interp(times.numpy(), seconds, column, math.nan, math.nan) for column in flat.T]
    return torch.from_numpy(np.stack(at, -1).reshape(len(times), *position.shape[1:]))


def _table(path: Path) -> tuple[list[str], NDArray]:
    path = regular_file(path, TABLE, _unreadable)
    try:
        # Spreadsheets begin a file with a byte-order mark.
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *rows = [[cell.strip() for cell in row] for row in csv.reader(file) if row]
            values = [[float(cell or "nan") for cell in row] for row in rows]
    except (OSError, ValueError) as error:
        raise _unreadable(path, error, TABLE) from error
    wide = all(len(row) == len(header) for row in values)
    require(wide, "data.truth", f"'{path}': rows of other lengths than the first", "one cell per column")
    return header, np.array(values).reshape(len(values), len(header))


def _unreadable(path: object, found: object, expected: object) -> InputError:
    return InputError.of_key("data.truth", f"'{path}': {found}", expected)


def _range_table(
    header: list[str], table: NDArray, coordinates: Sequence[str], depth_m: float | None
) -> tuple[NDArray, NDArray]:
    named = len(header) == 2 and header[1].startswith("range") and header[1].endswith("km")
    require(named, "data.truth", f"columns {header}", "minute..., range...km")
    require(list(coordinates) == ["range", "depth"], "data.truth", "ranges", f"{list(coordinates)}")
    require(depth_m is not None, "data.truth_depth_m", depth_m, "the depth of the source, m")
    ranges = 1e3 * table[:, 1]
    return 60 * table[:, 0], np.stack([ranges, np.full_like(ranges, depth_m)], -1)[:, None]


def _object_table(header: list[str], table: NDArray, coordinates: Sequence[str]) -> NDArray:
    """Positions `(rows, L, d)`."""
    columns = dict(zip(header, table.T, strict=True))
    endings = tuple(f"_{name}" for name in coordinates)
    found = [(name.removesuffix(e), e) for name in header[1:] for e in endings if name.endswith(e)]
    objects = list(dict.fromkeys(name for name, _ in found))
    wanted = {"time_s", *(name + ending for name in objects for ending in endings)}
    fits = header[0] == "time_s" and bool(objects) and set(header) == wanted and len(columns) == len(header)
    expected = f"time_s, then NAME{' and NAME'.join(endings)} for each object"
    require(fits, "data.truth", f"columns {header}", expected)
    return np.stack([np.stack([columns[name + e] for e in endings], -1) for name in objects], 1)
