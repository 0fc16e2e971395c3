"""Where the data of an experiment come from: schemas for Hydra, range checks at the edge."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from torchdt.errors import require


@dataclass
class DataSettings:
    """Where the snapshots come from.

    Attributes:
        kind: `simulated` or `npz`.
        path: of the file, or a list of paths; their sequences are tracked as one batch.
    """

    kind: str = "simulated"
    path: Any = None

    def __post_init__(self) -> None:
        require(self.kind in ("simulated", "npz"), "data.kind", self.kind, "simulated or npz")
        given = bool(self.paths) and all(isinstance(path, str) and path for path in self.paths)
        expected = "the path of a file or a list of paths"
        require(self.kind == "simulated" or given, "data.path", self.path, expected)

    @property
    def paths(self) -> list[str]:
        """The files."""
        return list(self.path) if isinstance(self.path, list | tuple) else [self.path]

    @property
    def one_path(self) -> str:
        """The file, of kinds that read one.

        Raises:
            InputError: where none is given, or several are.
        """
        given = isinstance(self.path, str) and bool(self.path)
        require(given, "data.path", self.path, "the path of one file")
        return self.path


@dataclass
class StaticCopySettings:
    """A standing source made from one step of the data, see `torchdt.signals.static_copy`.

    Attributes:
        step: that is added to every step; None adds none.
        gain_db: of the data as they were, dB.
    """

    step: int | None = None
    gain_db: float = -3.0

    def __post_init__(self) -> None:
        require(math.isfinite(self.gain_db), "data.static_copy.gain_db", self.gain_db, "a finite number")


@dataclass
class SignalSettings(DataSettings):
    """Raw signals; `torchdt.signals.spectra` makes snapshots of the field's tones of them.

    Attributes:
        kind: `wav`, `npy` or `sio`.
        path: of one file, whose channels are the field's sensors in their order.
        sample_rate: Hz; may be left out where the file says it.
        window_length, hop: samples of each Fourier transform, and from one to the next.
        snapshots_per_step: J.
        search_hz: how far from its nominal frequency a tone is looked for, Hz.
        start_s, duration_s: part of the file, s; None goes on to its end.
        truth: path of a table, see `torchdt.signals.truth`.
        truth_path: without a table, the path of the scenario that the source takes from `start_s` on; without
            either there is no truth.
        truth_depth_m: depth that goes with a table of ranges alone.
        static_copy: adds a standing source.
    """

    kind: str = "wav"
    sample_rate: float | None = None
    window_length: int = 4096
    hop: int = 2048
    snapshots_per_step: int = 3
    search_hz: float = 1.0
    start_s: float = 0.0
    duration_s: float | None = None
    truth: str | None = None
    truth_path: str | None = None
    truth_depth_m: float | None = None
    static_copy: StaticCopySettings = dataclasses.field(default_factory=StaticCopySettings)

    def __post_init__(self) -> None:
        rate, duration = self.sample_rate, self.duration_s
        for name, holds, expected in (
            ("kind", self.kind in ("wav", "npy", "sio"), "wav, npy or sio"),
            ("sample_rate", rate is None or 0 < rate < math.inf, "a positive number of Hz or null"),
            ("start_s", 0 <= self.start_s < math.inf, "a number from 0 up"),
            ("duration_s", duration is None or 0 < duration < math.inf, "a positive number or null"),
        ):
            require(holds, f"data.{name}", getattr(self, name), expected)


@dataclass
class TartSettings(DataSettings):
    """Visibilities of a TART radio array, see `torchdt.scenario.tart`.

    Attributes:
        kind: `tart`.
        path: of one file.
        average: consecutive covariances that make one step.
        standing: take out what stands still and is no sky, see `torchdt.scenario.tart_standing`.
        effective_count: snapshots that a covariance counts as; None takes it from the misfit of point
            sources, see `torchdt.scenario.tart_count`.
    """

    kind: str = "tart"
    average: int = 10
    standing: bool = True
    effective_count: float | None = None

    def __post_init__(self) -> None:
        count = self.effective_count
        for name, holds, expected in (
            ("kind", self.kind == "tart", "tart"),
            ("average", self.average >= 1, "a positive integer"),
            ("effective_count", count is None or 1 <= count < math.inf, "a number from one up or null"),
        ):
            require(holds, f"data.{name}", getattr(self, name), expected)
