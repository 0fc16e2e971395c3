"""What a simulated scenario consists of; checked once when it is made."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any, ClassVar

from torchdt.core.errors import require
from torchdt.core.ranges import (
    FINITE,
    Checked,
    Count,
    Decibels,
    Each,
    Finite,
    Name,
    NotNegative,
    OneOf,
    Positive,
    Probability,
    Range,
    StepIndex,
    Steps,
)
from torchdt.model.distance import Distance, Euclidean, GreatCircle
from torchdt.model.region import Coordinate
from torchdt.simulation.disturbances import DisturbanceSettings
from torchdt.simulation.mismatch import MismatchSettings

AMPLITUDES = ("gaussian", "constant_modulus")
DISTANCES = ("euclidean", "great_circle")
POWERS = ("log_uniform", "uniform")


@dataclass
class PathSettings(Checked):
    """A way through the region.

    Attributes:
        times_s: times of the waypoints in seconds since the middle of the first step, increasing.
        positions: one position per waypoint, in the region's coordinates; a cubic spline joins three or
            more, a line two, and a single one stands still.
    """

    KEY: ClassVar[str] = "scenario.paths"

    times_s: list[Finite] = field(default_factory=lambda: [0.0])
    positions: list[Annotated[Any, Each(FINITE)]] = field(default_factory=lambda: [[0.0]])

    def __post_init__(self) -> None:
        super().__post_init__()
        expected = f"{len(self.times_s)} positions, one for each time"
        fits = len(self.positions) == len(self.times_s) > 0
        require(fits, "scenario.paths.positions", self.positions, expected)
        rising = all(a < b for a, b in pairwise(self.times_s))
        require(rising, "scenario.paths.times_s", self.times_s, "increasing times")


@dataclass
class SourceSettings(Checked):
    """One simulated source.

    Attributes:
        path: name of its path.
        power_db: power relative to the scenario's reference.
        birth, death: first step with the source, and first without it again (null: stays to the end).
        silences: pairs of first and last step in which the source is there but sends nothing.
        frozen_step: if not null, the source stands where the path is at this step, and one draw of its
            amplitudes is repeated in every step.
    """

    KEY: ClassVar[str] = "scenario.sources"

    path: str = ""
    power_db: Decibels = 0.0
    birth: StepIndex = 0
    death: StepIndex | None = None
    silences: list[list[StepIndex]] = field(default_factory=list)
    frozen_step: StepIndex | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        pairs = all(len(s) == 2 and s[0] <= s[1] for s in self.silences)
        require(pairs, f"{self.KEY}.silences", self.silences, "pairs [first, last]")
        ends = self.death is None or self.death > self.birth
        require(ends, f"{self.KEY}.death", self.death, f"a step after birth {self.birth}, or null")


@dataclass
class InterfererSettings(SourceSettings):
    """One simulated source that is no object of the truth, such as a ship outside the region of interest.

    Its amplitudes are Gaussian, whatever those of the sources are.
    """

    KEY: ClassVar[str] = "scenario.interferers"


@dataclass
class PopulationSettings(Checked):
    """Sources drawn from the tracker's model (Liang and Meyer, Sec. II-B) instead of being listed.

    Attributes:
        birth_mean: mu_B, mean number of new sources per step.
        survival: p_s, probability to go on existing for one step.
        power_shape: c_gamma, shape of the Gamma transition of the powers.
        noise_shape: c_eta, shape of the Gamma transition of the noise variances.
        power_db: lowest and highest initial power of each tone, relative to the scenario's reference.
        max_objects: number of sources at once; births beyond it are dropped. None drops none.
        power_density: of the initial powers between their limits: `log_uniform`, even in dB, or `uniform`, as
            the tracker assumes.
    """

    KEY: ClassVar[str] = "scenario.population"

    birth_mean: Annotated[float, Range("a number from 0 up", low=0, most=1e4)] = 1e-4
    survival: Probability = 0.95
    power_shape: Positive = 1e4
    noise_shape: Positive = 1e2
    power_db: list[Decibels] = field(default_factory=lambda: [0.0, 0.0])
    max_objects: Count | None = None
    power_density: Annotated[str, OneOf(POWERS)] = "log_uniform"

    def __post_init__(self) -> None:
        super().__post_init__()
        rising = len(self.power_db) == 2 and self.power_db[0] <= self.power_db[1]
        require(rising, f"{self.KEY}.power_db", self.power_db, "[lowest, highest]")


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
    period: float | None = None
    report_low: float | None = None
    report_high: float | None = None

    def __post_init__(self) -> None:
        Coordinate(**vars(self))  # which checks them


@dataclass
class ScenarioSettings(Checked):
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
        interferers: by name; sources that are not in the truth, on paths that may lie outside the region.
        population: draws the sources from the tracker's model; None for those of `sources`.
        mismatch: difference between the simulator's environment and array and the tracker's.
        disturbances: of the snapshots, which the tracker's model does not hold.
        gospa_cutoff, gospa_order: c, in units of the distance, and p.
        gospa_distance: `euclidean`, the shortest way round where a coordinate has a period; or
            `great_circle`, degrees between directions given as azimuth, or azimuth and elevation, in degrees.
        gospa_scale: what counts as one in each coordinate of the Euclidean distance, in its unit, so that
            coordinates of different units can be compared; None is one unit of each.
    """

    KEY: ClassVar[str] = "scenario"

    name: Name = "scenario"
    num_steps: Steps = 1
    step_s: Annotated[float, Range("a positive number", low=0, open_low=True, least=1e-9, most=1e9)] = 1.0
    num_snapshots: Count = 1
    snr_db: Decibels = 20.0
    amplitudes: Annotated[str, OneOf(AMPLITUDES)] = "gaussian"
    phase_step_deg: NotNegative = 20.0
    coordinates: list[CoordinateSettings] = field(default_factory=lambda: [CoordinateSettings()])
    paths: dict[str, PathSettings] = field(default_factory=dict)
    sources: dict[str, SourceSettings] = field(default_factory=dict)
    interferers: dict[str, InterfererSettings] = field(default_factory=dict)
    population: PopulationSettings | None = None
    mismatch: MismatchSettings = field(default_factory=MismatchSettings)
    disturbances: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    gospa_cutoff: Positive = 200.0
    gospa_order: Annotated[float, Range("a number from 1 up", low=1, most=100)] = 1.0
    gospa_distance: Annotated[str, OneOf(DISTANCES)] = "euclidean"
    gospa_scale: list[Positive] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            len(self.coordinates) >= 1, "scenario.coordinates", self.coordinates, "at least one coordinate"
        )
        size = self.gospa_order * abs(math.log10(self.gospa_cutoff))
        expected = f"an order whose power of the cutoff, {self.gospa_cutoff:g}, is no overflow"
        require(size < 100, "scenario.gospa_order", self.gospa_order, expected)
        either = self.population is None or not self.sources
        require(either, "scenario.sources", sorted(self.sources), "none beside scenario.population")
        width, known = len(self.coordinates), sorted(self.paths)
        self._check_distance(width)
        for name, path in self.paths.items():
            fits = all(len(position) == width for position in path.positions)
            require(fits, f"scenario.paths.{name}.positions", path.positions, f"{width} coordinates each")
        for name, source in [*self.sources.items(), *self.interferers.items()]:
            require(source.path in known, f"{source.KEY}.{name}.path", source.path, f"one of {known}")

    def _check_distance(self, width: int) -> None:
        if self.gospa_scale is not None:
            expected = f"{width} numbers, as the coordinates, or null"
            require(len(self.gospa_scale) == width, "scenario.gospa_scale", self.gospa_scale, expected)
        if self.gospa_distance == "great_circle":
            units = [coordinate.unit for coordinate in self.coordinates]
            expected = "euclidean, or coordinates azimuth, or azimuth and elevation, in deg"
            found = f"great_circle of coordinates in {', '.join(units)}"
            require(units in (["deg"], ["deg", "deg"]), "scenario.gospa_distance", found, expected)
            expected = "null beside a great circle, which has degrees"
            require(self.gospa_scale is None, "scenario.gospa_scale", self.gospa_scale, expected)

    @property
    def distance(self) -> Distance:
        """How far apart two positions are, for all that compares estimates with the truth."""
        if self.gospa_distance == "great_circle":
            return GreatCircle()
        scale = None if self.gospa_scale is None else tuple(self.gospa_scale)
        return Euclidean(scale, tuple(coordinate.period for coordinate in self.coordinates))

    @property
    def distance_unit(self) -> str:
        """Of the distance: that of the first coordinate, or none where each coordinate has its scale."""
        return self.coordinates[0].unit if self.gospa_scale is None else ""
