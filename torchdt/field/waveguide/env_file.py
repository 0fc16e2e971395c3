"""Environment files of the Acoustics Toolbox (Porter, The KRAKEN Normal Mode Program, 1992), if all is fluid.

Read are title, frequency, number of media, options, the rows `z cp cs rho alphap alphas` of each medium,
bottom option and half-space; what follows (phase speeds, range, depths of sources and receivers) is not. The
first medium is the water. Values are those of Fortran's list-directed input: blanks or commas between them;
nothing between two commas, or after `/`, repeats the row above.
"""

import math
import os
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from torchdt.core.errors import InputError
from torchdt.core.files import regular_file
from torchdt.field.waveguide.environment import Environment, HalfSpace, Knots, Layer

_EXPECTED = "an environment file of the Acoustics Toolbox"
_OPTION = re.compile(r"""(?:'([^']*)'|"([^"]*)"|([^\s,/!]*))\s*,?(.*)""")
_SAME_DEPTH = 1e-5  # m, within which KRAKEN takes a row for the last one of its medium
_SPEED_ERROR = 1e-3  # m/s, of straight lines that stand for squared slowness linear in depth
_DB_PER_NEPER = 20 / math.log(10.0)


class _Row(NamedTuple):
    """Figures at one depth: m, m/s, m/s, g/cm^3, and attenuations in the unit of the file."""

    depth: float
    speed: float
    shear_speed: float
    density: float
    attenuation: float
    shear_attenuation: float


def read_env(path: str | os.PathLike[str]) -> Environment:
    """Read a waveguide from an environment file.

    Sound speed linear between the rows (option `C`) is taken as it is; its inverse square linear between them
    (`N`) by straight lines that are nowhere more than 0.001 m/s away. Attenuations `W` (dB/wavelength), `Q`
    and `L` (loss parameter) are those of the wavelength at each depth, as in KRAKEN. `F` (dB/(m kHz)), `N`
    (Np/m) and `M` (dB/m) are the same between two rows, where KRAKEN interpolates the imaginary part of the
    speed and has a few per cent more if the rows' speeds differ by a half. The last two hold at the file's
    frequency, and are in proportion to frequency at others.

    Args:
        path: the file.

    Raises:
        InputError: naming file and line, where something is missing or makes no sense, and where the file
            asks for what `Environment` does not have: shear, rough interfaces, boundaries other than a vacuum
            above and a half-space below, a top that is not at depth 0, water that absorbs or is of a density
            other than 1, several densities or attenuations in one sediment, further kinds of interpolation.
    """
    name = regular_file(path, _EXPECTED)
    try:
        lines = _Lines(name, name.read_text(encoding="utf-8", errors="replace"))
    except OSError as error:
        raise InputError.of_path(path, (error.strerror or str(error)).lower(), _EXPECTED) from error
    lines.read("a title")
    (frequency,) = lines.numbers("a frequency in Hz", [None])
    lines.require(frequency > 0, f"frequency {frequency:g}", "a positive number of Hz")
    (num_media,) = lines.numbers("the number of media", [None])
    lines.require(num_media in range(1, 1000), f"{num_media:g} media", "a whole number of them from 1 up")
    interpolation, unit = _read_options(lines)

    row = _Row(0.0, 1500.0, 0.0, 1.0, 0.0, 0.0)  # what the first row may repeat, as in KRAKEN
    profile: Knots = ()
    layers: list[Layer] = []
    for _ in range(int(num_media)):
        rows = _read_medium(lines, row, is_water=not profile)
        row, knots = rows[-1], _straighten(rows, interpolation)
        if not profile:
            profile = knots
            continue
        loss = _attenuation(row.attenuation, unit, frequency)
        for (_, upper), (bottom, lower) in pairwise(knots):
            layers.append(Layer(bottom, upper, lower, row.density, *loss))
    _read_bottom(lines)
    row = _read_row(lines, row._replace(depth=0.0))  # whose depth means nothing
    halfspace = HalfSpace(row.speed, row.density, *_attenuation(row.attenuation, unit, frequency))
    return Environment(profile, tuple(layers), halfspace)


class _Lines:
    """Goes through a file line by line; an error names the line that was read last."""

    def __init__(self, path: Path, text: str):
        self._path, self._lines, self._number = path, text.split("\n"), 0

    def require(self, holds: bool, found: object, expected: object) -> None:
        if not holds:
            raise InputError(f"path '{self._path}', line {self._number}: found {found}, expected {expected}")

    def read(self, expected: str) -> str:
        """The next line that is not blank."""
        line = ""
        while not line:
            self.require(self._number < len(self._lines), "the end of the file", expected)
            line = self._lines[self._number].strip()
            self._number += 1
        return line

    def option(self, expected: str) -> tuple[str, str]:
        """Letters, with or without quotes, and the rest of the line."""
        *letters, rest = _OPTION.findall(self.read(expected))[0]
        return "".join(letters), rest

    def numbers(self, expected: str, default: Sequence[float | None], line: str | None = None) -> list[float]:
        """Numbers of a line, the next one unless given; None in `default` is for those that must be there."""
        line = self.read(expected) if line is None else line
        text = re.split("[/!]", line)[0]
        fields = re.split(r"\s*,\s*|\s+", text.strip())
        missing = len(default) - len(fields)
        ended = line[len(text) :].startswith("/")
        self.require(ended or missing <= 0, f"{len(fields)} values without '/'", f"{expected}, or '/'")
        fields += [""] * missing
        return [self._number_of(*pair, expected) for pair in zip(fields, default, strict=False)]

    def _number_of(self, field: str, default: float | None, expected: str) -> float:
        if not field and default is not None:
            return default
        try:
            value = float(re.sub("[dD]", "e", field))
        except ValueError:
            value = math.nan
        self.require(math.isfinite(value), repr(field) if field else "nothing", expected)
        return value


def _read_options(lines: _Lines) -> tuple[str, str]:
    """Letters of the interpolation and of the unit of attenuations."""
    letters, _ = lines.option("top options such as 'CVW'")
    interpolation, boundary, unit, volume, altimetry = list(letters.ljust(5)[:5])
    found = f"top options '{letters}'"
    lines.require(interpolation in "CN", found, "C or N first: speeds, or their inverse squares, are linear")
    lines.require(boundary == "V", found, "V second: a vacuum above the water")
    lines.require(unit in "NFMWQL", found, "N, F, M, W, Q or L third: the unit of attenuations")
    lines.require(volume == " ", found, "no fourth letter: the water absorbs nothing")
    lines.require(altimetry not in "~*", found, "no altimetry: the surface is flat")
    return interpolation, unit


def _read_bottom(lines: _Lines) -> None:
    letters, rest = lines.option("a bottom option such as 'A'")
    found = f"bottom option '{letters}'"
    lines.require(letters.strip() == "A", found, "'A': a half-space (vacuum, rigid bottom and files are not)")
    (roughness,) = lines.numbers("the roughness of the bottom, m", [0.0], rest)
    lines.require(roughness == 0, f"roughness {roughness:g} m", "0: interfaces are smooth")


def _read_medium(lines: _Lines, above: _Row, is_water: bool) -> list[_Row]:
    """Rows of one medium, the first of them where the medium above ends."""
    names = "number of mesh points, roughness and depth of a medium"
    _, roughness, bottom = lines.numbers(names, [0.0, 0.0, None])
    lines.require(roughness == 0, f"roughness {roughness:g} m", "0: interfaces are smooth")
    lines.require(bottom > above.depth, f"depth {bottom:g} m", f"a medium that ends below {above.depth:g} m")
    first = _read_row(lines, above)
    starts = abs(first.depth - above.depth) < _SAME_DEPTH
    lines.require(starts, f"depth {first.depth:g} m", f"{above.depth:g} m, where the medium starts")
    plain = first.density == 1 and first.attenuation == 0
    found = "density {0.density:g} and attenuation {0.attenuation:g}"
    lines.require(plain or not is_water, found.format(first), "1 and 0: the first medium is the water")
    rows = [first._replace(depth=above.depth)]
    while rows[-1].depth < bottom - _SAME_DEPTH:
        row = _read_row(lines, rows[-1])
        within = rows[-1].depth < row.depth < bottom + _SAME_DEPTH
        expected = f"one below {rows[-1].depth:g} m, down to {bottom:g} m where the medium ends"
        lines.require(within, f"depth {row.depth:g} m", expected)
        same = (row.density, row.attenuation) == (first.density, first.attenuation)
        lines.require(
            same, found.format(row), f"{first.density:g} and {first.attenuation:g} as above, in one medium"
        )
        rows.append(row)
    return rows


def _read_row(lines: _Lines, above: _Row) -> _Row:
    row = _Row(*lines.numbers("z cp cs rho alphap alphas", above))
    lines.require(row.speed > 0, f"sound speed {row.speed:g}", "a positive number of m/s")
    lines.require(row.shear_speed == 0, f"shear speed {row.shear_speed:g}", "0: all media are fluids")
    lines.require(row.density > 0, f"density {row.density:g}", "a positive number of g/cm^3")
    lines.require(row.attenuation >= 0, f"attenuation {row.attenuation:g}", "a number not below zero")
    return row


def _straighten(rows: Sequence[_Row], interpolation: str) -> Knots:
    """Knots (depth, speed) between which the speed is linear."""
    knots = [(rows[0].depth, rows[0].speed)]
    for (z0, c0, *_), (z1, c1, *_) in pairwise(rows):
        if interpolation == "N":
            # c = (1 / c0^2 + slope s)^(-1/2), 0 < s < 1; its chords are off by 1/8 of the second derivative.
            slope = c1**-2 - c0**-2
            pieces = math.ceil(math.sqrt(0.75 * slope**2 * max(c0, c1) ** 5 / (8 * _SPEED_ERROR)))
            inside = [i / pieces for i in range(1, pieces)]
            knots += [(z0 + s * (z1 - z0), (c0**-2 + s * slope) ** -0.5) for s in inside]
        knots.append((z1, c1))
    return tuple(knots)


def _attenuation(value: float, unit: str, frequency: float) -> tuple[float, str]:
    """Attenuation in one of the units of `Layer`, and that unit."""
    # A loss parameter is the attenuation in nepers per radian of phase, a quality factor half its inverse.
    if unit == "Q":
        value, unit = 0.5 / value if value else 0.0, "L"
    per_khz = {"F": 1.0, "M": 1000 / frequency, "N": 1000 / frequency * _DB_PER_NEPER}
    per_wavelength = {"W": 1.0, "L": 2 * math.pi * _DB_PER_NEPER}
    if unit in per_khz:
        return value * per_khz[unit], "dB/(m kHz)"
    return value * per_wavelength[unit], "dB/wavelength"
