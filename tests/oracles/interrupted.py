"""Runs of `track` that are stopped between two steps, and what they leave."""

from contextlib import contextmanager
from unittest import mock

from torchdt.app.live import LiveReport

ALWAYS = "checkpoint_s=1e-9"  # a checkpoint after each step
ALONE = "memory_gb=1e-6"  # a chunk for each sequence
POINTS = ("tracker.slots=4", "tracker.particles=100", "tracker.detector.threshold=8")
LINE = ("scenario=line_array", "scenario.num_steps=5")
ALL = {"scalars": 0, "histograms": 0}
NUMBERS = ("tracks.csv", "gospa.csv")
KEPT = ("tracks.csv", "gospa.csv", "metrics.json", "manifest.json", "checkpoint.pt")


@contextmanager
def stopped(sequence, step, error=RuntimeError):
    """Tracking ends where this step of this sequence is done, and not yet in a checkpoint."""
    observe = LiveReport.__call__

    def stopping(self, now, state, estimate, sequences):
        if (sequences.start, now) == (sequence, step):
            raise error("stopped")
        observe(self, now, state, estimate, sequences)

    with mock.patch.object(LiveReport, "__call__", stopping):
        yield


def untouched(directory, *names):
    """What does not change where nothing is written."""
    return {name: ((directory / name).read_bytes(), (directory / name).stat().st_mtime_ns) for name in names}


def contents(directory, names=NUMBERS):
    return [(directory / name).read_bytes() for name in names]
