"""From a recording in any units to tracks in the same units."""

import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Generator

from torchdt.chunks import MOST_ON_CPU, bytes_per_sequence, free_memory_gb, plan, run_chunks
from torchdt.errors import require
from torchdt.history import TrackHistory
from torchdt.protocol import Tracker
from torchdt.random import RandomStreams
from torchdt.scenario.recording import Recording


def track(
    recording: Recording,
    tracker: Tracker[Any],
    seeds: Sequence[int],
    on_step: Callable[[int, TrackHistory, slice], None] | None = None,
    *,
    memory_gb: float | None = None,
    workers: int = 1,
) -> TrackHistory:
    """Track every sequence of a recording, without gradients, in chunks that the memory can hold.

    Neither the chunks nor the workers change the estimates by more than rounding.

    Args:
        recording: B sequences.
        tracker: of any kind.
        seeds: one per sequence.
        on_step: called after each step with its index, the estimates, and the sequences that these are of;
            by several threads at once where there are several workers.
        memory_gb: what all chunks that are tracked at the same time may take, 1e9 bytes; None allows half of
            what is free. It is an estimate that is kept, see `bytes_per_sequence`.
        workers: chunks tracked at the same time; they share the threads of the linear algebra.

    Returns:
        History of batch `(B,)` with powers, noise and evidence in units of the recording.

    Raises:
        InputError: where the recording does not fit the field, there is not one seed for each sequence, or
            `memory_gb` or `workers` is not positive.
        NumericalError: where the filter broke down, naming the sequences of the chunk.
    """
    number = recording.batch_size
    require(len(seeds) == number, "seeds", len(seeds), f"{number}, one for each sequence")
    device = tracker.region.low.device
    if memory_gb is None:
        memory_gb = free_memory_gb(device) / 2
    most = MOST_ON_CPU if device.type == "cpu" else None
    chunks = plan(number, bytes_per_sequence(tracker, recording), memory_gb, workers, most)

    def track_some(sequences: slice, check: Callable[[], None]) -> TrackHistory:
        def report(step: int, estimate: TrackHistory) -> None:
            check()
            if on_step is not None:
                on_step(step, estimate, sequences)

        return _track_chunk(recording.select(sequences), tracker.select(sequences), seeds[sequences], report)

    parts = run_chunks(track_some, chunks, workers)
    return TrackHistory(*(torch.cat(fields) for fields in zip(*parts, strict=True)))


def _track_chunk(
    recording: Recording,
    tracker: Tracker[Any],
    seeds: Sequence[int],
    on_step: Callable[[int, TrackHistory], None],
) -> TrackHistory:
    region = tracker.region
    prepared = tracker.prepare(recording)
    filter_seeds = [derive_seed(seed, "filter") for seed in seeds]
    streams = RandomStreams.from_seeds(
        filter_seeds, (recording.batch_size,), region.low.dtype, region.low.device
    )
    with torch.inference_mode():  # of the thread that calls
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
