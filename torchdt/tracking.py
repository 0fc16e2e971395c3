"""From a recording in any units to tracks in the same units."""

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Generator

from torchdt.history import TrackHistory
from torchdt.protocol import Tracker
from torchdt.random import RandomStreams
from torchdt.scenario.recording import Recording


def track(
    recording: Recording,
    tracker: Tracker[Any],
    seeds: Sequence[int],
    on_step: Callable[[int, TrackHistory], None] | None = None,
) -> TrackHistory:
    """Track every sequence of a recording, without gradients.

    Args:
        recording: B sequences.
        tracker: of any kind.
        seeds: one per sequence.
        on_step: called after each step with its index and estimates.

    Returns:
        History of batch `(B,)` with powers, noise and evidence in units of the recording.

    Raises:
        InputError: where the recording does not fit the field.
        NumericalError: where the filter broke down.
    """
    region = tracker.region
    prepared = tracker.prepare(recording)
    filter_seeds = [derive_seed(seed, "filter") for seed in seeds]
    streams = RandomStreams.from_seeds(
        filter_seeds, (recording.batch_size,), region.low.dtype, region.low.device
    )
    with torch.inference_mode():
        history = tracker.run(prepared.measurement, prepared.priors, streams, on_step)
    unit = prepared.scale.to(history.noise.device)
    square = unit.square().to(history.noise.dtype)
    measurement = prepared.measurement
    # The density of complex data z = unit * z' is that of z' over unit^2 for every complex entry.
    entries = (measurement.num_snapshots * measurement.present.sum(-1)).sum(-1)
    jacobian = 2 * entries.double() * unit.log()[:, None]
    return history._replace(
        power=history.power * square[:, None, None, None],
        noise=history.noise * square[:, None, None],
        log_evidence=history.log_evidence.double() - jacobian,
    )


def derive_seed(seed: int, purpose: str) -> int:
    """Seed of an independent stream for one purpose."""
    digest = hashlib.blake2b(f"{purpose}:{seed}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") & (2**63 - 1)


def generator(seed: int, purpose: str) -> Generator:
    """A CPU generator for one purpose."""
    return Generator().manual_seed(derive_seed(seed, purpose))
