"""Histories of one run written by hand."""

from collections.abc import Sequence

import torch

from torchdt.filter.history import TrackHistory


def line_history(label: Sequence[Sequence[int]], position: Sequence[Sequence[float]]) -> TrackHistory:
    """Labels and positions `(K, N)` on a line; all objects with a label are declared, 0 is an empty slot."""
    labels, place = torch.tensor(label), torch.tensor(position, dtype=torch.float32)
    state = torch.stack([place, torch.zeros_like(place)], -1)
    blank = torch.zeros(len(labels))
    return TrackHistory(blank, blank, labels > 0, labels, state[..., :1], state, *[blank] * 7)
