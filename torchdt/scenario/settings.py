"""What a simulated scenario consists of; checked once when it is made."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from torchdt.errors import require

AMPLITUDES = ("gaussian", "constant_modulus")


def _are_numbers(values: Any) -> bool:
    """Whether this is a list of finite numbers; nested lists escape the type checks of the schema."""
    return isinstance(values, list) and all(isinstance(v, int | float) and math.isfinite(v) for v in values)


@dataclass
class PathSettings:
    """A way through the region.

    Attributes:
        times_s: times of the waypoints in seconds since the middle of the first step, increasing.
        positions: one position per waypoint, in the region's coordinates; a cubic spline joins three or
            more, a line two, and a single one stands still.
    """

    times_s: list[float] = field(default_factory=lambda: [0.0])
    positions: list[Any] = field(default_factory=lambda: [[0.0]])

    def __post_init__(self) -> None:
        expected = f"{len(self.times_s)} positions, one for each time"
        numbers = all(_are_numbers(position) for position in self.positions)
        require(numbers, "scenario.paths.positions", self.positions, "finite numbers")
        fits = len(self.positions) == len(self.times_s) > 0
        require(fits, "scenario.paths.positions", self.positions, expected)
        rising = all(a < b for a, b in pairwise(self.times_s))
        require(rising, "scenario.paths.times_s", self.times_s, "increasing times")


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
        pairs = all(_are_numbers(s) and len(s) == 2 and 0 <= s[0] <= s[1] for s in self.silences)
        require(pairs, "scenario.sources.silences", self.silences, "pairs [first, last]")
        require(self.birth >= 0, "scenario.sources.birth", self.birth, "a step from 0 up")
        require(math.isfinite(self.power_db), "scenario.sources.power_db", self.power_db, "a finite number")
        frozen = self.frozen_step is None or self.frozen_step >= 0
        require(frozen, "scenario.sources.frozen_step", self.frozen_step, "a step from 0 up, or null")
        ends = self.death is None or self.death > self.birth
        require(ends, "scenario.sources.death", self.death, f"a step after birth {self.birth}, or null")


@dataclass
class MismatchSettings:
    """How the environment of the simulator differs from the tracker's; drawn anew for each run.

    Attributes:
        eof_scale: standard deviations per sound-speed EOF coefficient; 0 keeps the nominal profile.
        tilt_deg: smallest and largest magnitude of the array tilt, degrees; the sign is random.
        water_depth_m: smallest and largest magnitude of the change of water depth, m; random sign.
        seed: of the one environment that all runs share; None draws each run's from its own seed.
    """

    eof_scale: float = 0.0
    tilt_deg: list[float] = field(default_factory=lambda: [0.0, 0.0])
    water_depth_m: list[float] = field(default_factory=lambda: [0.0, 0.0])
    seed: int | None = None

    def __post_init__(self) -> None:
        require(self.eof_scale >= 0, "scenario.mismatch.eof_scale", self.eof_scale, "a number from 0 up")
        for name in ("tilt_deg", "water_depth_m"):
            limits = getattr(self, name)
            holds = len(limits) == 2 and 0 <= limits[0] <= limits[1]
            require(holds, f"scenario.mismatch.{name}", limits, "[smallest, largest], both from 0 up")

    @property
    def matched(self) -> bool:
        """Whether the simulator keeps to the tracker's environment."""
        return self.eof_scale == 0 and self.tilt_deg[1] == 0 and self.water_depth_m[1] == 0


@dataclass
class PopulationSettings:
    """Sources drawn from the tracker's model (Liang and Meyer, Sec. II-B) instead of being listed.

    Attributes:
        birth_mean: mu_B, mean number of new sources per step.
        survival: p_s, probability to go on existing for one step.
        power_shape: c_gamma, shape of the Gamma transition of the powers.
        noise_shape: c_eta, shape of the Gamma transition of the noise variances.
        power_db: lowest and highest initial power of each tone, relative to the scenario's reference; uniform
            in dB between them.
        max_objects: number of sources at once; births beyond it are dropped. None drops none.
    """

    birth_mean: float = 1e-4
    survival: float = 0.95
    power_shape: float = 1e4
    noise_shape: float = 1e2
    power_db: list[float] = field(default_factory=lambda: [0.0, 0.0])
    max_objects: int | None = None

    def __post_init__(self) -> None:
        limits, most = self.power_db, self.max_objects
        rising = _are_numbers(limits) and len(limits) == 2 and limits[0] <= limits[1]
        for name, holds, expected in (
            ("birth_mean", 0 <= self.birth_mean < math.inf, "a number from 0 up"),
            ("survival", 0 <= self.survival <= 1, "a probability"),
            ("power_shape", 0 < self.power_shape < math.inf, "a positive number"),
            ("noise_shape", 0 < self.noise_shape < math.inf, "a positive number"),
            ("power_db", rising, "[lowest, highest], finite numbers"),
            ("max_objects", most is None or most >= 1, "a positive integer or null"),
        ):
            require(holds, f"scenario.population.{name}", getattr(self, name), expected)


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
        population: draws the sources from the tracker's model; None for those of `sources`.
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
    population: PopulationSettings | None = None
    mismatch: MismatchSettings = field(default_factory=MismatchSettings)
    gospa_cutoff: float = 200.0
    gospa_order: float = 1.0

    def __post_init__(self) -> None:
        for name, holds, expected in (
            ("num_steps", self.num_steps >= 1, "a positive integer"),
            ("num_snapshots", self.num_snapshots >= 1, "a positive integer"),
            ("step_s", 0 < self.step_s < math.inf, "a positive number"),
            ("snr_db", math.isfinite(self.snr_db), "a finite number"),
            ("gospa_cutoff", 0 < self.gospa_cutoff < math.inf, "a positive number"),
            ("gospa_order", 1 <= self.gospa_order < math.inf, "a number from 1 up"),
            ("phase_step_deg", 0 <= self.phase_step_deg < math.inf, "a number from 0 up"),
            ("coordinates", len(self.coordinates) >= 1, "at least one coordinate"),
            ("amplitudes", self.amplitudes in AMPLITUDES, " or ".join(AMPLITUDES)),
        ):
            require(holds, f"scenario.{name}", getattr(self, name), expected)
        either = self.population is None or not self.sources
        require(either, "scenario.sources", sorted(self.sources), "none beside scenario.population")
        width, known = len(self.coordinates), sorted(self.paths)
        for name, path in self.paths.items():
            fits = all(len(position) == width for position in path.positions)
            require(fits, f"scenario.paths.{name}.positions", path.positions, f"{width} coordinates each")
        for name, source in self.sources.items():
            require(source.path in known, f"scenario.sources.{name}.path", source.path, f"one of {known}")
