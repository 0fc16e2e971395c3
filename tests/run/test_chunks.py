import math
import threading
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor

import pytest
import torch
from oracles.line_array import BEARING, SMALL_PAPER, make_field, make_region, make_tracker, simulate

from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import InputError
from torchdt.core.linalg import NumericalError
from torchdt.core.random import RandomStreams
from torchdt.data.recording import Recording, validate
from torchdt.field.stacked import StackedField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.intensity.settings import Ignored, Intensity
from torchdt.filter.paper.config import PaperConfig
from torchdt.filter.paper.tracker import PaperTracker
from torchdt.model.region import Coordinate, Region
from torchdt.run.chunks import INTENSITIES, SURFACES, bytes_per_sequence, plan, run_chunks

WITHOUT = TrackerConfig(undetected=Ignored())
FOUR = [slice(2 * i, 2 * i + 2) for i in range(4)]


@pytest.mark.parametrize("batch_size", [1, 2, 7, 16])
@pytest.mark.parametrize("fit", [0.5, 1, 3, 100])
@pytest.mark.parametrize("workers", [1, 2, 3])
def test_chunks_are_equal_and_as_few_as_fit(batch_size, fit, workers):
    """`fit` sequences fit beside one another, in all chunks that are worked on at the same time."""
    found = plan(batch_size, 10**9, fit, workers)
    assert [i for chunk in found for i in range(batch_size)[chunk]] == list(range(batch_size))
    sizes = [chunk.stop - chunk.start for chunk in found]
    assert max(sizes) - min(sizes) <= 1
    busy = min(workers, batch_size)
    room = max(1, int(fit / busy))
    assert max(sizes) <= room
    assert len(found) == max(busy, math.ceil(batch_size / room))


def test_no_chunk_holds_more_than_it_may():
    sizes = [chunk.stop - chunk.start for chunk in plan(20, 1, 1.0, 2, most=8)]
    assert sizes == [6, 7, 7]


@pytest.mark.parametrize(
    ("key", "value", "arguments"),
    [("memory_gb", 0, (0, 1)), ("memory_gb", math.nan, (math.nan, 1)), ("workers", 0, (1, 0))],
)
def test_what_makes_no_sense_is_named(key, value, arguments):
    with pytest.raises(InputError, match=f"key '{key}': found {value}, expected a positive"):
        plan(4, 10**6, *arguments)


def recording(batch_size: int = 2, steps: int = 5) -> Recording:
    snapshots = simulate(1, steps=steps)[0]
    return validate(step_s=1.0, snapshots=snapshots.expand(batch_size, -1, -1, -1, -1))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_field_for_each_sequence_counts_its_dictionary(dtype):
    shared = make_tracker(dtype)
    own = DirectTracker(StackedField([make_field(dtype)] * 2), shared.region, 1.0, shared.config)
    extra = bytes_per_sequence(own, recording()) - bytes_per_sequence(shared, recording())
    each = own.dictionary.response[0]
    assert extra == 2 * each.numel() * each.element_size()


def test_responses_are_counted():
    one, more = make_tracker(), make_tracker(particles=300)
    extra = bytes_per_sequence(more, recording()) - bytes_per_sequence(one, recording())
    # 8 objects, 2 tones: three complex responses of 8 sensors, 10 points of the power.
    assert extra == 100 * 8 * 2 * (3 * 16 + 10) * 8


def test_the_intensity_of_undetected_objects_is_counted():
    ignored = bytes_per_sequence(make_tracker(undetected=Ignored()), recording())
    # 70 cells of five levels: as many nodes as keep together, one node, none at all.
    for most, least in (10**6, 2), (350, 1), (349, 0):
        tracker = make_tracker(undetected=Intensity(hypotheses=most))
        carried = 0 if tracker.undetected is None else tracker.undetected.init(torch.Size()).numel()
        assert bytes_per_sequence(tracker, recording()) - ignored == INTENSITIES * carried * 8
        assert carried >= 350 * least


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_surfaces_of_a_search_are_counted(dtype):
    coarse, fine = (
        DirectTracker(
            make_field(dtype), Region([Coordinate(**BEARING | {"cell": cell})], dtype), 1.0, WITHOUT
        )
        for cell in (2.0, 1.0)
    )
    extra = bytes_per_sequence(fine, recording()) - bytes_per_sequence(coarse, recording())
    assert extra == 70 * 2 * SURFACES * dtype.itemsize  # cells, tones


def test_data_and_estimates_are_counted():
    tracker = make_tracker()
    short, long = recording(1, steps=5), recording(1, steps=9)
    prepared = tracker.prepare(short)
    streams = RandomStreams.from_seeds([1], (1,), torch.float64)
    history = tracker.run(prepared.measurement, prepared.priors, streams)
    step = sum(8 * values[0, 0].numel() for values in history)
    extra = bytes_per_sequence(tracker, long) - bytes_per_sequence(tracker, short)
    # Three copies of 2 tones, 3 snapshots, 8 sensors.
    assert extra == 4 * (2 * step + 3 * 2 * 3 * 8 * 16)
    assert bytes_per_sequence(tracker, recording(6)) == bytes_per_sequence(tracker, recording(2))


def test_the_graph_of_the_paper_has_responses_for_every_factor():
    def size(**config) -> int:
        tracker = PaperTracker(make_field(), make_region(), 1.0, PaperConfig(**(SMALL_PAPER | config)))
        return bytes_per_sequence(tracker, recording())

    # 2 tones, 3 snapshots; 7 objects: three complex responses of 8 sensors; of one, its likelihood.
    assert size(particles=300) - size() == 100 * 3 * 2 * 3 * (7 * 16 + 20) * 8
    assert size(power_particles=21) - size() == 200 * 3 * 2 * 3 * 8


def test_a_detector_works_on_a_dictionary():
    config = TwoStepConfig(particles=100, detector=PursuitConfig())
    coarse, fine = (
        TwoStepTracker(
            make_field(torch.float32), Region([Coordinate(**BEARING | {"cell": cell})]), 1.0, config
        )
        for cell in (2.0, 1.0)
    )
    extra = bytes_per_sequence(fine, recording()) - bytes_per_sequence(coarse, recording())
    assert extra == 70 * 2 * 2 * 8 * 4  # cells, tones, complex, sensors, single precision


@pytest.fixture
def four_threads():
    """Whatever the machine has."""
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("workers", [1, 2, 9])
def test_results_are_in_order(workers):
    def work(chunk, check):
        time.sleep(0.01 * (8 - chunk.start))
        return chunk

    assert run_chunks(work, FOUR, workers) == FOUR


@pytest.mark.parametrize(("workers", "share"), [(1, 4), (2, 2), (4, 1), (9, 1)])
def test_workers_share_the_threads(four_threads, workers, share):
    together = threading.Barrier(min(workers, 4))

    def work(chunk, check):
        together.wait(timeout=10)  # as many chunks at the same time as there are workers
        return torch.get_num_threads()

    assert run_chunks(work, FOUR, workers) == [share] * 4
    assert torch.get_num_threads() == 4
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(torch.get_num_threads).result() == 4


def test_no_more_chunks_at_a_time_than_workers():
    lock, now, most = threading.Lock(), [0], [0]

    def work(chunk, check):
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.02)
        with lock:
            now[0] -= 1

    run_chunks(work, FOUR, 2)
    assert most == [2]


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(
    ("bad", "name"), [(slice(4, 8), "sequences 4-7"), (slice(4, 5), "sequence 4")], ids=["many", "one"]
)
def test_a_breakdown_names_its_sequences(workers, bad, name):
    def work(chunk, check):
        if chunk == bad:
            raise NumericalError("covariance: not positive definite")

    with pytest.raises(NumericalError, match=f"^{name}: covariance: not positive"):
        run_chunks(work, [slice(0, 4), bad], workers)


@pytest.mark.parametrize("workers", [1, 2])
def test_other_errors_stay_and_have_the_sequences_in_a_note(workers):
    def work(chunk, check):
        if chunk.start == 2:
            raise InputError("key 'snapshots': found only zeros")

    with pytest.raises(InputError, match=r"^key 'snapshots': found only zeros\nin sequences 2-3$"):
        run_chunks(work, FOUR, workers)


def test_an_error_stops_the_others(four_threads):
    both, ended = threading.Barrier(2), []

    def work(chunk, check):
        if chunk.start < 4:
            both.wait(timeout=10)
        if chunk.start == 0:
            raise NumericalError("broken")
        try:
            for _ in range(1000):
                time.sleep(0.01)
                check()
            ended.append("not stopped")
        except CancelledError:
            ended.append("stopped")
            raise

    with pytest.raises(NumericalError, match=r"^sequences 0-1: broken$"):
        run_chunks(work, FOUR, 2)
    assert set(ended) == {"stopped"}
    assert len(ended) <= 2  # the last chunk has not begun
    assert torch.get_num_threads() == 4
