"""What a simulated scenario consists of; checked once when it is made."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from torchdt.errors import InputError


@dataclass
class PathSettings:
    """A way through the region.

    Attributes:
        times_s: times of the waypoints in seconds since the first step, increasing.
        positions: one position per waypoint, in the region's coordinates; a cubic spline joins three or
            more, a line two, and a single one stands still.
    """

    times_s: list[float] = field(default_factory=lambda: [0.0])
    positions: list[Any] = field(default_factory=lambda: [[0.0]])

    def __post_init__(self) -> None:
        expected = f"{len(self.times_s)} positions, one for each time"
        _check("paths.positions", self.positions, expected, lambda v: len(v) == len(self.times_s) > 0)
        rising = all(a < b for a, b in pairwise(self.times_s))
        _check("paths.times_s", self.times_s, "increasing times", lambda v: rising)


@dataclass
class SourceSettings:
    """One simulated source.

    Attributes:
        path: name of its path.
        power_db: power relative to the scenario's reference.
        birth, death: first step with the source, and first without it again (null: stays to the end).
        silences: pairs of first and last step in which the source is there but sends nothing.
        frozen_step: if not null, the source stands where the path is at this step, and one draw of its
            amplitudes is repeated in every step.
    """

    path: str = ""
    power_db: float = 0.0
    birth: int = 0
    death: int | None = None
    silences: list[Any] = field(default_factory=list)
    frozen_step: int | None = None

    def __post_init__(self) -> None:
        pairs = all(len(s) == 2 and 0 <= s[0] <= s[1] for s in self.silences)
        _check("sources.silences", self.silences, "pairs [first, last]", lambda v: pairs)
        _check("sources.birth", self.birth, "a step from 0 up", lambda v: v >= 0)
        after = f"a step after birth {self.birth}, or null"
        _check("sources.death", self.death, after, lambda v: v is None or v > self.birth)


@dataclass
class MismatchSettings:
    """How the environment of the simulator differs from the tracker's; drawn anew for each run.

    Attributes:
        eof_scale: standard deviations per sound-speed EOF coefficient; 0 keeps the nominal profile.
        tilt_deg: smallest and largest magnitude of the array tilt, degrees; the sign is random.
        water_depth_m: smallest and largest magnitude of the change of water depth, m; random sign.
    """

    eof_scale: float = 0.0
    tilt_deg: list[float] = field(default_factory=lambda: [0.0, 0.0])
    water_depth_m: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def __post_init__(self) -> None:
        _check("eof_scale", self.eof_scale, "a number from 0 up", lambda v: v >= 0)
        for name in ("tilt_deg", "water_depth_m"):
            value = getattr(self, name)
            _check(
                name,
                value,
                "[smallest, largest], both from 0 up",
                lambda v: len(v) == 2 and 0 <= v[0] <= v[1],
            )

    @property
    def matched(self) -> bool:
        """Whether the simulator keeps to the tracker's environment."""
        return self.eof_scale == 0 and self.tilt_deg[1] == 0 and self.water_depth_m[1] == 0


@dataclass
class CoordinateSettings:
    """One coordinate of the region, see `torchdt.model.region.Coordinate`."""

    name: str = "range"
    unit: str = "m"
    low: float = 0.0
    high: float = 1.0
    cell: float = 1.0
    rate_low: float = -1.0
    rate_high: float = 1.0
    driving_variance: float = 1.0


@dataclass
class ScenarioSettings:
    """Region, time axis and sources of a scenario.

    Attributes:
        name: of the scenario, for reports.
        num_steps: K.
        step_s: time between steps, s.
        num_snapshots: J per step.
        snr_db: power of a source of 0 dB over the noise, per array element, both per snapshot.
        amplitudes: `gaussian` or `constant_modulus`.
        phase_step_deg: how far the phase of a constant-modulus amplitude walks per snapshot, degrees.
        coordinates: the region of interest.
        paths: by name.
        sources: by name; none is noise alone.
        mismatch: difference between the simulator's and the tracker's environment.
        gospa_cutoff, gospa_order: c, in units of the coordinates, and p.
    """

    name: str = "scenario"
    num_steps: int = 1
    step_s: float = 1.0
    num_snapshots: int = 1
    snr_db: float = 20.0
    amplitudes: str = "gaussian"
    phase_step_deg: float = 20.0
    coordinates: list[CoordinateSettings] = field(default_factory=lambda: [CoordinateSettings()])
    paths: dict[str, PathSettings] = field(default_factory=dict)
    sources: dict[str, SourceSettings] = field(default_factory=dict)
    mismatch: MismatchSettings = field(default_factory=MismatchSettings)
    gospa_cutoff: float = 200.0
    gospa_order: float = 1.0

    def __post_init__(self) -> None:
        for name in ("num_steps", "num_snapshots"):
            _check(name, getattr(self, name), "a positive integer", lambda v: v >= 1)
        for name in ("step_s", "gospa_cutoff"):
            _check(name, getattr(self, name), "a positive number", lambda v: 0 < v < float("inf"))
        _check("gospa_order", self.gospa_order, "a number from 1 up", lambda v: v >= 1)
        _check("phase_step_deg", self.phase_step_deg, "a number from 0 up", lambda v: v >= 0)
        _check("coordinates", len(self.coordinates), "at least one coordinate", lambda v: v >= 1)
        kinds = ("gaussian", "constant_modulus")
        _check("amplitudes", self.amplitudes, " or ".join(kinds), lambda v: v in kinds)
        width = len(self.coordinates)
        for name, path in self.paths.items():
            fits = all(len(p) == width for p in path.positions)
            _check(
                f"paths.{name}.positions", path.positions, f"{width} coordinates each", lambda v, ok=fits: ok
            )
        for name, source in self.sources.items():
            known = sorted(self.paths)
            _check(f"sources.{name}.path", source.path, f"one of {known}", lambda v, known=known: v in known)


def _check(name: str, value: Any, expected: str, holds: Callable[[Any], bool]) -> None:
    if not holds(value):
        raise InputError.of_key(f"scenario.{name}", value, expected)
