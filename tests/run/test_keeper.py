"""Tracking that goes on from what was kept, as if it had never stopped."""

import shutil

import pytest
import torch
from oracles.line_array import make_field, make_region, make_tracker, simulate
from oracles.storage import full_disk

from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.errors import InputError, StorageError
from torchdt.data.recording import Recording, validate
from torchdt.filter.tracker import Tracker
from torchdt.run.chunks import bytes_per_sequence
from torchdt.run.keeper import Keeper
from torchdt.run.track import track

pytestmark = pytest.mark.slow
SEEDS, STEPS, FINGERPRINT = [7, 8, 9], 6, {"seed": 7}
TWO = (((0.0, -40.0), (20.0, -25.0)), ((0.0, 30.0), (20.0, 20.0)))
KINDS = ("direct", "two_step")
both = pytest.mark.parametrize("kind", KINDS)


class Stop(Exception):
    pass


def build(kind: str, dtype: torch.dtype = torch.float32) -> Tracker:
    if kind == "direct":
        return make_tracker(dtype)
    config = TwoStepConfig(slots=4, particles=200, detector=PursuitConfig(points=4))
    return TwoStepTracker(make_field(dtype), make_region(dtype), 1.0, config)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Three sequences in a unit of their own, with a sensor that fails in a step."""
    snapshots = torch.stack([simulate(seed, *TWO, steps=STEPS)[0] for seed in (1, 2, 3)])
    snapshots[:, 3, :, :, 0] = torch.nan
    return validate(step_s=1.0, snapshots=30 * snapshots)


@pytest.fixture(scope="module")
def whole(recording):
    """What tracking gives that nothing interrupts, in two chunks."""
    return {
        kind: track(recording, build(kind), SEEDS, memory_gb=gigabytes(kind, recording)) for kind in KINDS
    }


def gigabytes(kind, recording, at_once=2):
    return at_once * bytes_per_sequence(build(kind), recording) / 1e9


def keeper(directory, every_s=1e-9, **options):
    return Keeper(directory, FINGERPRINT, every_s, **options)


def stop_at(chunk, step):
    def on_step(now, state, estimate, sequences):
        if (sequences.start, now) == (chunk, step):
            raise Stop

    return on_step


def interrupt(directory, recording, kind, chunk, step, every_s=1e-9):
    memory = gigabytes(kind, recording)
    with pytest.raises(Stop):
        track(
            recording,
            build(kind),
            SEEDS,
            stop_at(chunk, step),
            memory_gb=memory,
            keep=keeper(directory, every_s),
        )


def go_on(directory, recording, kind, on_step=None, **options):
    return track(recording, build(kind), SEEDS, on_step, keep=keeper(directory, **options))


def equal(found, expected):
    pairs = zip(found, expected, strict=True)
    return all(torch.equal(a.nan_to_num(1e9), b.nan_to_num(1e9)) for a, b in pairs)


@both
@pytest.mark.parametrize("step", [0, 3, STEPS - 1])
def test_interrupted_at_any_step(tmp_path, recording, whole, kind, step):
    """The chunks of the interrupted run are kept, although the memory would now hold all sequences."""
    interrupt(tmp_path, recording, kind, 1, step)
    seen = []
    history = go_on(tmp_path, recording, kind, lambda k, s, e, sequences: seen.append((sequences.start, k)))
    assert equal(history, whole[kind])
    last_kept = [(0, STEPS - 1)] + ([(1, step - 1)] if step else [])
    assert seen == sorted({*last_kept, *((1, k) for k in range(step, STEPS))})


@both
def test_interrupted_again(tmp_path, recording, whole, kind):
    interrupt(tmp_path, recording, kind, 1, 2)
    interrupt(tmp_path, recording, kind, 1, 4)
    assert equal(go_on(tmp_path, recording, kind), whole[kind])


def test_the_log_says_where_tracking_goes_on(tmp_path, recording, caplog):
    interrupt(tmp_path, recording, "direct", 1, 2)
    with caplog.at_level("INFO", "torchdt.run.keeper"):
        go_on(tmp_path, recording, "direct")
    assert caplog.messages == [
        f"sequences 0-0: {STEPS} of {STEPS} steps were done, going on",
        f"sequences 1-2: 2 of {STEPS} steps were done, going on",
    ]


@both
def test_chunks_that_are_done_are_not_tracked_again(tmp_path, recording, kind, monkeypatch):
    expected = go_on(tmp_path, recording, kind)
    tracker = build(kind)
    monkeypatch.setattr(type(tracker), "step", None)
    again = track(recording, tracker, SEEDS, keep=keeper(tmp_path))
    assert equal(again, expected)


@both
def test_what_observers_see_when_tracking_goes_on(tmp_path, recording, whole, kind):
    """The last kept step again, in the units of the recording, and a state of the tracker's own type."""
    interrupt(tmp_path, recording, kind, 0, 3)
    seen, expected = {}, {}
    go_on(tmp_path, recording, kind, lambda k, state, e, s: seen.setdefault((s.start, k), (state, e)))
    track(
        recording,
        build(kind),
        SEEDS,
        lambda k, state, e, s: expected.setdefault((s.start, k), (state, e)),
        memory_gb=gigabytes(kind, recording),
    )
    assert sorted(seen) == [(0, k) for k in range(2, STEPS)] + [(1, k) for k in range(STEPS)]
    for place, (state, estimate) in seen.items():
        assert type(state) is type(expected[place][0])
        assert torch.equal(state.next_label, expected[place][0].next_label)
        assert torch.equal(state.objects[0], expected[place][0].objects[0])
        assert equal(estimate, expected[place][1])
        k, rows = place[1], slice(0, 1) if place[0] == 0 else slice(1, 3)
        assert equal(estimate, [part[rows, k] for part in whole[kind]])


def test_workers_keep_their_chunks_side_by_side(tmp_path, recording):
    tracker = build("direct")
    memory = gigabytes("direct", recording)
    expected = track(recording, tracker, SEEDS, memory_gb=memory, workers=2)
    with pytest.raises(Stop):
        track(recording, tracker, SEEDS, stop_at(1, 3), memory_gb=memory, workers=2, keep=keeper(tmp_path))
    assert equal(track(recording, tracker, SEEDS, workers=2, keep=keeper(tmp_path)), expected)


@pytest.fixture(scope="module")
def one(recording):
    return recording.select(slice(0, 1))


@pytest.fixture(scope="module")
def tracked(one, tmp_path_factory):
    """What is kept of one sequence that was tracked to its end."""
    directory = tmp_path_factory.mktemp("tracked")
    track(one, build("direct"), [7], keep=keeper(directory))
    return directory


@pytest.fixture
def kept(tracked, tmp_path):
    """A copy of it, to be changed."""
    return shutil.copytree(tracked, tmp_path / "kept")


@pytest.mark.parametrize(("every_s", "number"), [(1e-9, STEPS), (1e9, 1)])
def test_time_says_when_to_write_and_the_end_always_does(tmp_path, one, every_s, number):
    """What goes to the disk before comes before."""
    path, found = tmp_path / "0-0.pt", []
    keep = keeper(tmp_path, every_s, before=lambda: found.append(path.read_bytes() if path.exists() else b""))
    track(one, build("direct"), [7], keep=keep)
    assert len(set(found)) == len(found) == number
    assert path.read_bytes() not in found
    assert sorted(file.name for file in tmp_path.iterdir()) == ["0-0.pt", "plan.pt"]
    keep.clear()
    assert not tmp_path.exists()


def test_time_counts_from_the_last_writing(tmp_path, one, monkeypatch):
    """A step takes a second."""
    now, written = [0], []
    monkeypatch.setattr("torchdt.run.keeper.time.monotonic", lambda: now[0])

    def on_step(*_):
        now[0] += 1

    keep = keeper(tmp_path, 2, before=lambda: written.append(now[0]))
    track(one, build("direct"), [7], on_step, keep=keep)
    assert written == [2, 4, STEPS]


def test_time_of_all_processes(tmp_path, one, monkeypatch):
    """A hundred seconds pass at each look at the clock."""
    clock = iter(range(0, 10**6, 100))
    monkeypatch.setattr("torchdt.run.keeper.time.perf_counter", lambda: next(clock))
    first = keeper(tmp_path)
    track(one, build("direct"), [7], keep=first)  # written after each step
    assert first.seconds == 100 * STEPS + 100
    second = keeper(tmp_path)
    assert second.seconds == 100
    track(one, build("direct"), [7], keep=second)
    assert second.seconds == 100 * STEPS + 200


def test_the_time_of_chunks_that_were_tracked_together_counts_once(tmp_path, monkeypatch):
    clock = iter(range(0, 10**6, 100))
    monkeypatch.setattr("torchdt.run.keeper.time.perf_counter", lambda: next(clock))
    first = keeper(tmp_path)
    paths = [tmp_path / "0-0.pt", tmp_path / "1-1.pt"]
    for path in paths:
        first.save(path, {})  # at 100 s and 200 s
    second = keeper(tmp_path)
    for path in reversed(paths):
        second.load(path)
    assert second.seconds == 200 + 100


def test_another_run(kept, one):
    with pytest.raises(InputError, match=r"key 'seed': found 8, expected 7, as in .*plan.pt; another folder"):
        track(one, build("direct"), [7], keep=Keeper(kept, {"seed": 8}))


def test_the_state_of_another_tracker(kept, one):
    with pytest.raises(InputError, match=r"0-0.pt'.*content.state: 5 entries, expected 2 entries; another"):
        track(one, build("two_step"), [7], keep=keeper(kept))


def changed(place, value):
    """A change of one entry somewhere in a checkpoint."""

    def change(content):
        *way, last = place
        for key in way:
            content[key] = list(content[key]) if isinstance(content[key], tuple) else content[key]
            content = content[key]
        if value is None:
            del content[last]
        else:
            content[last] = value(content[last])

    return change


@pytest.mark.parametrize(
    ("name", "place", "value", "words"),
    [
        ("plan.pt", ["chunks"], None, "content: the keys , expected the keys chunks"),
        ("plan.pt", ["chunks"], lambda _: [], "chunks \\[\\], expected consecutive ones of 1 sequences"),
        ("plan.pt", ["chunks"], lambda _: [(0, 2)], "expected consecutive ones of 1 sequences"),
        ("plan.pt", ["chunks"], lambda _: [(0, 0), (0, 1)], "expected consecutive ones of 1 sequences"),
        ("plan.pt", ["chunks"], lambda _: [("0", 1)], "content.chunks.0: '0', expected int"),
        ("0-0.pt", ["seconds"], lambda _: "long", "content.seconds: 'long', expected float"),
        ("0-0.pt", ["state"], None, "expected the keys state, history, streams, seconds"),
        ("0-0.pt", ["state"], lambda state: state[:2], "content.state: 2 entries, expected 5 entries"),
        ("0-0.pt", ["state", 0, 0], lambda t: t[:, :1], "content.state.0.0: a tensor .* expected a tensor"),
        ("0-0.pt", ["state", 0, 0], lambda t: t.double(), "of float64, expected a tensor .* of float32"),
        ("0-0.pt", ["history"], lambda _: (), "a history of 0 steps, expected 1 to 6"),
        ("0-0.pt", ["history"], lambda h: [t[:, :0] for t in h], "a history of 0 steps, expected 1 to 6"),
        ("0-0.pt", ["history", 0], lambda t: torch.cat([t, t], 1), "a history of 12 steps, expected 1 to 6"),
        ("0-0.pt", ["history", 0], lambda t: t[:, :3], r"content.history.1: a tensor \(1, 6, 4\) of float"),
        ("0-0.pt", ["history", 5], lambda t: t[..., :1], "content.history.5: a tensor"),
        ("0-0.pt", ["streams"], lambda _: [], "content.streams: 0 entries, expected 1 entries"),
        ("0-0.pt", ["streams", 0], lambda t: t[:9], r"content.streams.0: a tensor \(9,\) of uint8"),
    ],
)
def test_content_that_is_not_what_this_tracker_keeps(kept, one, name, place, value, words):
    """With the right fingerprint: one error says where it differs and what to do."""
    stored = torch.load(kept / name, weights_only=True)
    changed(place, value)(stored["content"])
    torch.save(stored, kept / name)
    with pytest.raises(InputError, match=rf"{name}': found .*{words}.*; another folder starts anew"):
        track(one, build("direct"), [7], keep=keeper(kept))


@pytest.mark.parametrize("name", ["plan.pt", "0-0.pt"])
def test_part_of_a_file(kept, one, name):
    content = (kept / name).read_bytes()
    (kept / name).write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=rf"{name}'.*expected a complete checkpoint of 'tracking'"):
        track(one, build("direct"), [7], keep=keeper(kept))


def test_a_full_disk(tmp_path, recording, whole):
    """Tracking ends; what was kept before stays, and goes on when there is space."""
    written = []
    keep = keeper(tmp_path, before=lambda: written.append(1))
    memory = gigabytes("direct", recording)
    with (
        full_disk(lambda: len(written) > STEPS + 3),
        pytest.raises(StorageError, match=r"1-2.pt: No space left"),
    ):
        track(recording, build("direct"), SEEDS, memory_gb=memory, keep=keep)
    seen = []
    history = go_on(
        tmp_path, recording, "direct", lambda k, s, e, sequences: seen.append((sequences.start, k))
    )
    assert seen == [(0, STEPS - 1), *((1, k) for k in range(2, STEPS))]
    assert equal(history, whole["direct"])


def test_a_folder_that_cannot_be_made(tmp_path, one):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match=r"^cannot write .*file/checkpoint: Not a directory$"):
        track(one, build("direct"), [7], keep=keeper(tmp_path / "file" / "checkpoint"))
