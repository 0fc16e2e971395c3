"""Batches in chunks: each as large as the memory allows, several at the same time."""

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from typing import Any, TypeVar

import torch

from torchdt.core.errors import require
from torchdt.core.linalg import NumericalError
from torchdt.data.recording import Recording
from torchdt.filter.direct import DirectTracker
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.tracker import Tracker

Result = TypeVar("Result")

COPIES = 3
"""Responses of an object at the peak of a step, itself among them; measured with the default array."""

INTENSITIES = 7
"""Intensities of undetected objects at the peak of a step, that before it among them; measured."""

SURFACES = 12
"""Numbers for each tone and cell at the peak of a search for new objects; measured."""

MOST_ON_CPU = 8
"""Sequences in a chunk on a CPU: of more, the tensors leave its cache, and each sequence takes longer."""


def bytes_per_sequence(tracker: Tracker[Any], recording: Recording) -> int:
    """Estimate of the memory that tracking takes for each sequence, in bytes.

    It is the sum of these, each number in the precision of the tracker unless said otherwise:

    - direct tracking: for each object (slots and births alike, as if all were taken) the responses of its
      particles, `P I M` complex, `COPIES` times, and the likelihood over its powers, `P I G`;
      `INTENSITIES` times what is believed of undetected objects, `V L C`; `SURFACES` times what is known of
      the cells, `I C`;
    - the paper's graph: for each object the responses of its particles once for every snapshot (or sensor,
      where these are fewer) and tone, `P M` complex, `COPIES` times, and for one object its likelihood there
      over all powers, `P G`, `COPIES` times;
    - detection: work space of about a dictionary;
    - a dictionary, `I C M` complex, where each sequence has a field; twice, since it is joined of parts;
    - the data three times in double precision: as recorded, scaled, and as statistics;
    - the history of K steps twice: step by step, and joined.

    What does not grow with the batch is left out, the dictionary of a shared field among it.
    """
    config, region, K = tracker.config, tracker.region, recording.num_steps
    num_tones, num_sensors = recording.num_tones, recording.num_sensors
    dictionary = num_tones * region.num_cells * 2 * num_sensors
    if isinstance(tracker, DirectTracker):
        direct = tracker.config
        of_particle = num_tones * (COPIES * 2 * num_sensors + direct.power_points)
        work = (direct.slots + direct.births) * direct.particles * of_particle
        hypotheses = direct.undetected.num_hypotheses(region, tracker.model, recording.step_s)
        work += INTENSITIES * hypotheses + SURFACES * num_tones * region.num_cells
    elif isinstance(config, PaperConfig):
        factors = num_tones * min(recording.data.shape[-2], num_sensors)
        of_particle = (config.slots + config.births) * 2 * num_sensors + config.power_particles
        work = COPIES * factors * config.particles * of_particle
    else:
        work = dictionary
    own = 0 if tracker.field.num_sequences is None else 2 * dictionary
    estimates = K * (
        config.slots * (region.num_coordinates + 2 * region.num_entries + num_tones + 5) + 5 * num_tones + 2
    )
    data = recording.data[0].numel() * torch.complex128.itemsize
    return (work + own + 2 * estimates) * region.low.dtype.itemsize + 3 * data


def plan(
    batch_size: int, bytes_per_sequence: int, memory_gb: float, workers: int, most: int | None = None
) -> list[slice]:
    """Chunks of a batch, in order and of equal size up to one sequence.

    They are as few as fit, and no fewer than the workers where there are as many sequences. A chunk holds
    one sequence at least, whatever the memory.

    Args:
        batch_size: number B of sequences.
        bytes_per_sequence: what one of them takes.
        memory_gb: what all workers may take together, 1e9 bytes.
        workers: chunks worked on at the same time.
        most: sequences in a chunk, whatever the memory; None sets no limit.

    Raises:
        InputError: where `memory_gb` or `workers` is not positive.
    """
    require(memory_gb > 0, "memory_gb", memory_gb, "a positive number")
    require(workers >= 1, "workers", workers, "a positive integer")
    busy = min(workers, batch_size)
    fit = max(1, min(int(memory_gb * 1e9 / (busy * bytes_per_sequence)), most or batch_size))
    number = max(math.ceil(batch_size / fit), busy)
    edges = [batch_size * i // number for i in range(number + 1)]
    return [slice(start, end) for start, end in itertools.pairwise(edges)]


def run_chunks(
    work: Callable[[slice, Callable[[], None]], Result], chunks: Sequence[slice], workers: int
) -> list[Result]:
    """Work on all chunks, some of them at the same time.

    The threads of the linear algebra are shared out evenly: PyTorch counts them for each thread that calls.

    Args:
        work: of one chunk; calls the function it is handed every now and then, which raises where another
            chunk has failed.
        chunks: of a batch.
        workers: number of threads; one works in the calling thread.

    Returns:
        What each chunk gives, in order.

    Raises:
        NumericalError: that of the first chunk to fail, with its sequences named.
        Exception: any other of that chunk, with its sequences in a note.
    """
    stop, workers = threading.Event(), min(workers, len(chunks))

    def check() -> None:
        if stop.is_set():
            raise CancelledError

    def named(chunk: slice) -> Result:
        try:
            return work(chunk, check)
        except NumericalError as error:
            raise NumericalError(f"{_name(chunk)}: {error}") from error
        except Exception as error:
            error.add_note(f"in {_name(chunk)}")
            raise

    if workers == 1:
        return [named(chunk) for chunk in chunks]
    threads = torch.get_num_threads()
    share = max(1, threads // workers)
    try:
        with ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(share,)) as pool:
            futures = [pool.submit(named, chunk) for chunk in chunks]
            try:
                for future in as_completed(futures):
                    future.result()
            except BaseException:
                stop.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    finally:
        # Threads that start later take the number that was set last, by whichever thread.
        torch.set_num_threads(threads)
    return [future.result() for future in futures]


def _name(chunk: slice) -> str:
    one = chunk.stop - chunk.start == 1
    return f"sequence {chunk.start}" if one else f"sequences {chunk.start}-{chunk.stop - 1}"
