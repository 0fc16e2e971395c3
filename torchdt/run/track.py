"""From a recording in any units to tracks in the same units."""

import hashlib
import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Generator

from torchdt.core.errors import require
from torchdt.core.memory import free_memory_gb, require_memory
from torchdt.core.random import RandomStreams
from torchdt.core.trees import join
from torchdt.data.prepare import Prepared
from torchdt.data.recording import Recording
from torchdt.filter.history import StepEstimate, TrackHistory, history_like
from torchdt.filter.tracker import Tracker
from torchdt.run.chunks import MOST_ON_CPU, bytes_per_sequence, plan, run_chunks
from torchdt.run.keeper import ChunkKeeper, Keeper

log = logging.getLogger(__name__)


def track(
    recording: Recording,
    tracker: Tracker[Any],
    seeds: Sequence[int],
    on_step: Callable[[int, Any, StepEstimate, slice], None] | None = None,
    *,
    memory_gb: float | None = None,
    workers: int = 1,
    keep: Keeper | None = None,
) -> TrackHistory:
    """Track every sequence of a recording, without gradients, in chunks that the memory can hold.

    Neither the chunks nor the workers change the estimates by more than rounding.

    Args:
        recording: B sequences.
        tracker: of any kind.
        seeds: one per sequence.
        on_step: called after each step with its index, the tracker's state, in which data are of order one,
            the estimates in units of the recording, and the sequences that these are of; by several threads
            at once where there are several workers. Sequences that go on from what was kept begin with their
            last kept step.
        memory_gb: what all chunks that are tracked at the same time may take, 1e9 bytes; None allows half of
            what is free. It is an estimate that is kept, see `bytes_per_sequence`.
        workers: chunks tracked at the same time; they share the threads of the linear algebra.
        keep: keeps what was done, and knows what another process did: chunks and estimates are then those
            of a run that was never interrupted.

    Returns:
        History of batch `(B,)` with powers, noise and evidence in units of the recording, and in double
        precision.

    Raises:
        InputError: where the recording does not fit the field, a sequence does not fit into the memory, there
            is not one seed for each sequence, `memory_gb` or `workers` is not positive, or what was kept is
            of another run.
        NumericalError: where the filter broke down even without the data of a step, naming it.
        StorageError: where what is done cannot be kept.
    """
    number = recording.batch_size
    require(len(seeds) == number, "seeds", len(seeds), f"{number}, one for each sequence")
    own = tracker.field.num_sequences
    require(own in (None, number), "field", f"fields of {own} sequences", f"{number}, as in the recording")
    device = tracker.region.low.device
    if memory_gb is None:
        memory_gb = free_memory_gb(device) / 2
    most, size = MOST_ON_CPU if device.type == "cpu" else None, bytes_per_sequence(tracker, recording)
    require_memory(size, device, "tracker", "slots, particles and cells that one sequence needs")
    chunks = plan(number, size, memory_gb, workers, most)
    if keep is not None:
        chunks = keep.plan(chunks)
    shape = number, recording.num_steps, len(chunks), min(workers, number), memory_gb
    log.debug("%d sequences of %d steps in %d chunks, %d at a time, within %.3g GB", *shape)

    def track_some(sequences: slice, check: Callable[[], None]) -> TrackHistory:
        def report(step: int, state: Any, estimate: StepEstimate) -> None:
            check()
            if on_step is not None:
                on_step(step, state, estimate, sequences)

        some = recording.select(sequences), tracker.select(sequences), seeds[sequences]
        return _track_chunk(
            *some, sequences.start, report, None if keep is None else partial(keep.of_chunk, sequences)
        )

    parts = run_chunks(track_some, chunks, workers)
    return join(parts)


def _track_chunk(
    recording: Recording,
    tracker: Tracker[Any],
    seeds: Sequence[int],
    first: int,
    on_step: Callable[[int, Any, StepEstimate], None],
    keep: Callable[[RandomStreams, int], ChunkKeeper] | None,
) -> TrackHistory:
    region = tracker.region
    prepared = tracker.prepare(recording)
    filter_seeds = [derive_seed(seed, "filter") for seed in seeds]
    streams = RandomStreams.from_seeds(
        filter_seeds, (recording.batch_size,), region.low.dtype, region.low.device
    )
    units = _Units(prepared)
    keeper = None if keep is None else keep(streams, recording.num_steps)

    def history_of(steps: int) -> TrackHistory:
        sizes = tracker.config.slots, region.num_coordinates, region.num_entries, recording.num_tones
        return history_like(recording.batch_size, steps, *sizes, region.low.dtype)

    def report(step: int, state: Any, estimate: StepEstimate) -> None:
        on_step(step, state, units.of_step(estimate, step))

    def report_and_keep(step: int, state: Any, estimate: StepEstimate) -> None:
        report(step, state, estimate)
        if keeper is not None:
            keeper(step, state, estimate)

    with torch.inference_mode():  # of the thread that calls
        past = None if keeper is None else keeper.past(tracker.init(prepared.priors), history_of)
        if past is not None:
            done = past.history.steps(1)
            report(len(done) - 1, past.state, done[-1])
        history = tracker.run(prepared.measurement, prepared.priors, streams, report_and_keep, past, first)
    return units.of(history)


class _Units:
    """Brings estimates from data of order one, batch `(B,)`, back to the units of the recording."""

    def __init__(self, prepared: Prepared) -> None:
        priors, measurement = prepared.priors, prepared.measurement
        unit = prepared.scale.to(priors.noise_max.device)
        # Double: in single precision, squares of what is below 1e-22 or above 1e19 do not exist.
        self.square = unit.square()
        # The density of complex data z = unit * z' is that of z' over unit^2 for every complex entry.
        entries = (measurement.num_snapshots * measurement.present.sum(-1)).sum(-1)
        self.jacobian = 2 * entries.double() * unit.log()[:, None]

    def of(self, history: TrackHistory, first: int = 0) -> TrackHistory:
        """Scale the history of some consecutive steps."""
        last = first + history.log_evidence.shape[1]
        return history._replace(
            power=history.power.double() * self.square[:, None, None, None],
            noise=history.noise.double() * self.square[:, None, None],
            log_evidence=history.log_evidence.double() - self.jacobian[:, first:last],
        )

    def of_step(self, estimate: StepEstimate, step: int) -> StepEstimate:
        """Scale the estimates of one step."""
        return self.of(TrackHistory.of_steps([estimate], 1), step).steps(1)[0]


def derive_seed(seed: int, purpose: str) -> int:
    """Seed of an independent stream for one purpose."""
    digest = hashlib.blake2b(f"{purpose}:{seed}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") & (2**63 - 1)


def generator(seed: int, purpose: str) -> Generator:
    """A CPU generator for one purpose."""
    return Generator().manual_seed(derive_seed(seed, purpose))
