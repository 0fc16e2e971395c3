"""A tracking run in TensorBoard, to be watched while it goes on."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hydra.core.hydra_config import HydraConfig
from matplotlib.figure import Figure
from torch import Tensor

from torchdt.app.figures import axis_of
from torchdt.app.report.clouds import Frame
from torchdt.app.report.hparams import row_metrics, row_settings
from torchdt.app.report.tensorboard import TensorBoardReport
from torchdt.app.score import score_step
from torchdt.app.settings import TrackSettings
from torchdt.core.trees import tree_map
from torchdt.data.recording import Recording
from torchdt.filter.history import StepEstimate, TrackHistory
from torchdt.model.region import Region


class LiveReport:
    """Writes each step of the first sequence into event files, where the settings want them.

    Use it as a context manager. All raise a `StorageError` where the event files cannot be written.

    Args:
        directory: folder of the event files, made with the first step.
        recording: B sequences.
        region: of the tracker.
        settings: of the run.
    """

    def __init__(
        self, directory: Path, recording: Recording, region: Region, settings: TrackSettings
    ) -> None:
        self.directory, self.recording, self.settings = directory, recording, settings
        self.frame = Frame.of_region(region, [axis_of(c) for c in region.coordinates])
        self._report: TensorBoardReport | None = None

    def __call__(self, step: int, state: Any, estimate: StepEstimate, sequences: slice) -> None:
        """Take in a step of some sequences; the first one says where a run begins or goes on."""
        if sequences.start > 0 or not self.settings.logging.tensorboard:
            return
        first, truth = slice(0, 1), self.recording.truth
        one = tree_map(lambda part: part[first], estimate)
        score = score_step(step, one, first, self.recording, self.settings)
        self._opened(step).add_step(
            step,
            self.recording.times()[0, step].item(),
            _first(state),
            one.select(0),
            None if score is None else score.select(0),
            None if truth is None else truth[0, step],
        )

    def finish(
        self, figures: Mapping[str, Figure], history: TrackHistory, metrics: Mapping[str, Any]
    ) -> None:
        """Write what is known at the end.

        Args:
            figures: of the first sequence by name.
            history: of all sequences.
            metrics: content of `metrics.json`.
        """
        last, plain = self.recording.num_steps - 1, dataclasses.asdict(self.settings)
        report = self._opened(last)
        for name, figure in figures.items():
            report.add_figure(f"figures/{name}", figure, last)
        report.add_config(plain)
        declared = history.declared.sum(-1).double().mean().item()
        row = row_settings(plain, metrics["tracker"], HydraConfig.get().overrides.task)
        report.add_hparams(row, row_metrics(metrics, declared), last)

    def flush(self) -> None:
        """Bring all steps so far to the disk."""
        if self._report is not None:
            self._report.flush()

    def _opened(self, step: int) -> TensorBoardReport:
        """The event files; where they are opened for this step, earlier ones from there on are hidden."""
        if self._report is None:
            logging = self.settings.logging
            frame = self.frame if logging.figures else None
            self._report = TensorBoardReport(self.directory, step, logging.interval, frame)
        return self._report

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._report is not None:
            self._report.close()


def _first(state: Any) -> Any:
    """The first sequence of nested named tuples of tensors."""
    return state[0] if isinstance(state, Tensor) else type(state)(*map(_first, state))
