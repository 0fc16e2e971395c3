"""Event files of TensorBoard: what the reports of all kinds of runs share."""

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from matplotlib.figure import Figure
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from torchdt.core.atomic import storing

Layout = Mapping[str, Mapping[str, list[str]]]
"""Charts of the tab Custom Scalars: by category and title, regular expressions of the tags in one chart."""

FLUSH_S = 10
"""Seconds after which a running job's events are on the disk, so that they can be watched."""


class EventReport:
    """Writes one run into event files; use it as a context manager, or call `close`.

    Numbers that are not finite are left out, as they would hide the scale of the rest.

    Args:
        directory: folder of the event files, made if absent.
        first_step: first step that will be written; what an earlier process wrote from there on is hidden.
        layout: of the custom scalars.

    Raises:
        StorageError: here and in all methods, where the files cannot be written.
    """

    def __init__(self, directory: str | os.PathLike[str], first_step: int, layout: Layout) -> None:
        self._directory = os.fspath(directory)
        charts = {
            category: {title: ["Multiline", tags] for title, tags in content.items()}
            for category, content in layout.items()
        }
        with storing(self._directory):
            self._events = SummaryWriter(self._directory, purge_step=first_step, flush_secs=FLUSH_S)
            self._events.add_custom_scalars(charts)

    def add_scalar(self, tag: str, value: float | None, step: int) -> None:
        """Write one number, unless there is none or it is not finite."""
        if value is not None and math.isfinite(value):
            with self._writer() as writer:
                writer.add_scalar(tag, value, step)

    def add_figure(self, tag: str, figure: Figure, step: int = 0) -> None:
        """Write a figure as an image under `tag`."""
        with self._writer() as writer:
            writer.add_figure(tag, figure, step, close=False)

    def add_hparams(
        self, settings: Mapping[str, object], metrics: Mapping[str, float | None], step: int
    ) -> None:
        """Write the row of this run in the table under HPARAMS, once; the metrics also as `hparam/<name>`.

        Args:
            settings: numbers, truth values and texts by name.
            metrics: those without a finite value leave their cell empty.
            step: at which the metrics are written, usually the last one.
        """
        tags = {f"hparam/{name}": value for name, value in metrics.items()}
        # `SummaryWriter.add_hparams` would open a run of its own, and a second row.
        with self._writer() as writer:
            for summary in hparams(dict(settings), tags):
                writer._get_file_writer().add_summary(summary)
        for tag, value in tags.items():
            self.add_scalar(tag, value, step)

    def flush(self) -> None:
        """Bring all that was written so far to the disk."""
        with self._writer() as writer:
            writer.flush()

    def close(self) -> None:
        """Write what is pending and close the files; more than once does no harm."""
        with self._writer() as writer:
            writer.close()

    @contextmanager
    def _writer(self) -> Iterator[SummaryWriter]:
        with storing(self._directory):
            yield self._events

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
