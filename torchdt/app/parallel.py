"""How a run is shared out over threads and chunks."""

from collections.abc import Callable, Sequence
from typing import Any

import torch

from torchdt.app.settings import MANY, TrackSettings
from torchdt.data.recording import Recording
from torchdt.filter.history import StepEstimate, TrackHistory
from torchdt.filter.tracker import Tracker
from torchdt.run.keeper import Keeper
from torchdt.run.track import track


def set_threads(settings: TrackSettings) -> None:
    """Set the threads of the linear algebra where the settings say how many.

    Without, jobs that run side by side need nothing: joblib's launcher, as others of its kind, gives each
    process its share of the cores through `OMP_NUM_THREADS`, which PyTorch takes over.
    """
    if settings.threads is not None:
        torch.set_num_threads(settings.threads)


def num_workers(settings: TrackSettings, batch_size: int) -> int:
    """Chunks to track at the same time: as set, or one for each thread where a CPU has a large batch."""
    if settings.workers is not None:
        return settings.workers
    many = batch_size >= MANY and torch.device(settings.device).type == "cpu"
    return torch.get_num_threads() if many else 1


def track_in_chunks(
    settings: TrackSettings,
    recording: Recording,
    tracker: Tracker[Any],
    seeds: Sequence[int],
    on_step: Callable[[int, Any, StepEstimate, slice], None] | None = None,
    keep: Keeper | None = None,
) -> TrackHistory:
    """Track with the workers and the memory of the settings, see `torchdt.run.track.track`."""
    workers = num_workers(settings, recording.batch_size)
    return track(recording, tracker, seeds, on_step, memory_gb=settings.memory_gb, workers=workers, keep=keep)
