"""Where the data of an experiment come from: schemas for Hydra, range checks at the edge."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from torchdt.core.errors import require
from torchdt.core.ranges import (
    Checked,
    Count,
    Decibels,
    Finite,
    NotNegative,
    OneOf,
    Positive,
    StepIndex,
    Steps,
)


@dataclass
class DataSettings(Checked):
    """Where the snapshots come from.

    Attributes:
        kind: `simulated` or `npz`.
        path: of the file, or a list of paths; their sequences are tracked as one batch.
    """

    KEY: ClassVar[str] = "data"

    kind: Annotated[str, OneOf(("simulated", "npz"))] = "simulated"
    path: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        given = bool(self.paths) and all(isinstance(path, str) and path for path in self.paths)
        expected = "the path of a file or a list of paths"
        require(self.kind != "npz" or given, "data.path", self.path, expected)

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
class StaticCopySettings(Checked):
    """A standing source made from one step of the data, see `torchdt.data.signals.static_copy`.

    Attributes:
        step: that is added to every step; None adds none.
        gain_db: of the data as they were, dB.
    """

    KEY: ClassVar[str] = "data.static_copy"

    step: StepIndex | None = None
    gain_db: Decibels = -3.0


@dataclass
class SignalSettings(DataSettings):
    """Raw signals; `torchdt.data.signals.spectra` makes snapshots of the field's tones of them.

    Attributes:
        kind: `wav`, `npy` or `sio`.
        path: of one file, whose channels are the field's sensors in their order.
        sample_rate: Hz; may be left out where the file says it.
        window_length, hop: samples of each Fourier transform, and from one to the next.
        snapshots_per_step: J.
        search_hz: how far from its nominal frequency a tone is looked for, Hz.
        start_s, duration_s: part of the file, s; None goes on to its end.
        truth: path of a table, see `torchdt.data.signals.truth`.
        truth_path: without a table, the path of the scenario that the source takes from `start_s` on; without
            either there is no truth.
        truth_depth_m: depth that goes with a table of ranges alone.
        static_copy: adds a standing source.
    """

    kind: Annotated[str, OneOf(("wav", "npy", "sio"))] = "wav"
    sample_rate: Positive | None = None
    window_length: Steps = 4096
    hop: Steps = 2048
    snapshots_per_step: Count = 3
    search_hz: NotNegative = 1.0
    start_s: NotNegative = 0.0
    duration_s: Positive | None = None
    truth: str | None = None
    truth_path: str | None = None
    truth_depth_m: Finite | None = None
    static_copy: StaticCopySettings = dataclasses.field(default_factory=StaticCopySettings)
