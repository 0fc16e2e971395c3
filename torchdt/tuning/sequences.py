"""Recordings of a training or held-out set as one batch."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchdt.core.errors import require
from torchdt.data.recording import Recording

ALIKE = ("step_s", "span_s", "num_snapshots", "freqs", "element_depths", "sensor_positions")


def stack_recordings(recordings: Sequence[Recording], pad: bool = False) -> tuple[Recording, Tensor]:
    """Join recordings of one array along the batch dimension.

    Args:
        recordings: one or more, each of one or more sequences.
        pad: let the number of steps differ: shorter ones get missing (NaN) steps at the end.

    Returns:
        The batch, and `(B, K)` bool: the steps that are not padding. The batch has truth where all its parts
        do; objects that a sequence lacks are absent throughout.

    Raises:
        InputError: where kind of data, tones, snapshots, sensors, time step or array differ, or lengths do
            without `pad`.
    """
    require(len(recordings) > 0, "recordings", "none", "at least one")
    first = recordings[0]
    kind = _kind(first)
    for other in recordings[1:]:
        require(_kind(other) == kind, "recordings", f"{kind} and {_kind(other)}", "data of one kind")
        here, there = tuple(first.data.shape[2:]), tuple(other.data.shape[2:])
        require(here == there, kind, f"steps of shapes {here} and {there}", "one shape")
        for key in ALIKE:
            mine, theirs = _plain(getattr(first, key)), _plain(getattr(other, key))
            require(mine == theirs, key, f"{mine} and {theirs}", "the same in all recordings")
    lengths = [r.num_steps for r in recordings]
    longest = max(lengths)
    require(
        pad or min(lengths) == longest,
        "recordings",
        f"lengths {lengths}",
        "equal numbers of steps, or pad: true",
    )
    data = torch.cat([_grow(r.data, 1, longest) for r in recordings])
    mask = torch.cat([(torch.arange(longest) < r.num_steps).expand(r.batch_size, -1) for r in recordings])
    truths = [r.truth for r in recordings if r.truth is not None]
    truth = None
    if len(truths) == len(recordings):
        most = max(t.shape[2] for t in truths)
        truth = torch.cat([_grow(_grow(t, 1, longest), 2, most) for t in truths])
    joined = replace(first, start_s=torch.cat([r.start_s for r in recordings]), truth=truth)
    return (
        replace(joined, snapshots=data) if kind == "snapshots" else replace(joined, covariance=data)
    ), mask


def _kind(recording: Recording) -> str:
    return "snapshots" if recording.covariance is None else "covariance"


def _plain(value: Tensor | float | None) -> object:
    return value.tolist() if isinstance(value, Tensor) else value


def _grow(values: Tensor, dim: int, size: int) -> Tensor:
    """NaN at the end of a dimension up to a size."""
    shape = list(values.shape)
    shape[dim] = size - shape[dim]
    return torch.cat([values, values.new_full(shape, torch.nan)], dim)
