"""A small line-array problem: 8 sensors, 2 tones, bearings; for tests of proposals and of the tracker."""

import torch
from torch import Tensor

from torchdt.field.plane_wave import LineArrayField
from torchdt.field.wrapped import WrappedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.proposal.adapted import Adapted
from torchdt.model.model import Model
from torchdt.model.region import Coordinate, Region
from torchdt.simulation.settings import CoordinateSettings, PathSettings, ScenarioSettings, SourceSettings
from torchdt.simulation.simulate import simulate_snapshots

FREQS, POSITIONS = (100.0, 150.0), tuple(5.0 * m for m in range(8))
BEARING = {
    "name": "bearing",
    "unit": "deg",
    "low": -70.0,
    "high": 70.0,
    "cell": 2.0,
    "rate_low": -1.0,
    "rate_high": 1.0,
    "driving_variance": 1e-3,
}
SMALL = {
    "slots": 4,
    "particles": 200,
    "power_points": 10,
    "noise_points": 24,
    "births": 4,
    "proposal": Adapted(rounds=4, round_size=64),
}
SMALL_PAPER = {
    "slots": 4,
    "particles": 200,
    "power_particles": 20,
    "noise_particles": 100,
    "births": 3,
}


class Silent(WrappedField):
    """A field that does not say how it scatters."""

    def incoherent(self, state: Tensor) -> None:
        return None


def make_field(dtype: torch.dtype = torch.float64) -> LineArrayField:
    return LineArrayField(FREQS, POSITIONS, dtype=dtype)


def make_region(dtype: torch.dtype = torch.float64) -> Region:
    return Region([Coordinate(**BEARING)], dtype)


def make_tracker(dtype: torch.dtype = torch.float64, **config) -> DirectTracker:
    """A tracker of other settings, and of other numbers of the model."""
    numbers = {name: config.pop(name) for name in Model().all_quantities() if name in config}
    settings, model = TrackerConfig(**(SMALL | config)), Model().with_numbers(numbers)
    return DirectTracker(make_field(dtype), make_region(dtype), 1.0, settings, model)


def simulate(
    seed: int,
    *paths: tuple[tuple[float, float], ...],
    steps: int = 20,
    powers_db: tuple[float, ...] | None = None,
    snr_db: float = 10.0,
    num_snapshots: int = 3,
) -> tuple[Tensor, Tensor]:
    """Snapshots (K, I, J, M) and truth (K, L, 1) of sources; each path is a row of (time, bearing)."""
    powers_db = powers_db or (0.0,) * len(paths)
    scenario = ScenarioSettings(
        num_steps=steps,
        num_snapshots=num_snapshots,
        snr_db=snr_db,
        coordinates=[CoordinateSettings(**BEARING)],
        paths={
            str(n): PathSettings([t for t, _ in path], [[b] for _, b in path]) for n, path in enumerate(paths)
        },
        sources={str(n): SourceSettings(str(n), power) for n, power in enumerate(powers_db)},
    )
    return simulate_snapshots(make_field(), scenario, torch.Generator().manual_seed(seed))
