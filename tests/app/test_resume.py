"""Interrupted runs of `track` that the same command finishes, with the same numbers."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from unittest import mock

import pytest
import torch
from oracles.scripts import FOLDER, SMALL
from oracles.storage import full_disk
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard import SummaryWriter

from torchdt.app import track
from torchdt.app.live import LiveReport
from torchdt.data.npz import write_npz
from torchdt.run import keeper
from torchdt.run.checkpoint import save_checkpoint

pytestmark = pytest.mark.slow
ALWAYS = "checkpoint_s=1e-9"  # a checkpoint after each step
ALONE = "memory_gb=1e-6"  # a chunk for each sequence
POINTS = ("tracker.slots=4", "tracker.particles=100", "tracker.detector.threshold=8")
LINE = ("scenario=line_array", "scenario.num_steps=5")
ALL = {"scalars": 0, "histograms": 0}
NUMBERS = ("tracks.csv", "gospa.csv")
KEPT = ("tracks.csv", "gospa.csv", "metrics.json", "manifest.json", "checkpoint.pt")
# By name, and the sequence and step at which they stop.
CASES = {
    ("chunks", 0, 0): (*SMALL, *LINE, "runs=2", ALONE),
    ("workers", 1, 3): (*SMALL, *LINE, "runs=2", "workers=2"),
    ("variants", 1, 2): (*SMALL, *LINE, "variants=[{{survival: 0.9}},{{survival: 0.99}}]", ALONE),
    ("npz", 1, 4): (*SMALL, *LINE, "data=npz", "data.path={folder}/two.npz", ALONE),
    ("mp_bp", 0, 2): (*LINE, "tracker=mp_bp", *POINTS, "runs=2", ALONE),
}


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


@pytest.fixture(scope="module")
def start(launch):
    """Run in a directory; the last argument of a key counts."""

    def start(directory, *overrides, small=True):
        outcome = launch(ALWAYS, f"hydra.run.dir={directory}", *overrides, small=small)
        outcome.directory = directory
        return outcome

    return start


@pytest.fixture(scope="module")
def whole(start, tmp_path_factory):
    """A run that nothing interrupts."""
    outcome = start(tmp_path_factory.mktemp("whole"), "runs=2", ALONE)
    assert outcome.status == 0, outcome.err
    return outcome


@pytest.fixture
def half(start, tmp_path):
    """The same, interrupted in its second sequence."""
    with stopped(1, 3):
        outcome = start(tmp_path, "runs=2", ALONE)
    assert outcome.status == 1
    assert "stopped" in outcome.err
    return outcome


@pytest.mark.parametrize(("case", "sequence", "step"), CASES)
def test_the_same_numbers(start, tmp_path, recording, case, sequence, step):
    write_npz(tmp_path / "two.npz", recording)
    arguments = [value.format(folder=tmp_path) for value in CASES[case, sequence, step]]
    expected = start(tmp_path / "whole", *arguments, small=False)
    assert expected.status == 0, expected.err
    with stopped(sequence, step):
        assert start(tmp_path / "half", *arguments, small=False).status == 1
    assert not (tmp_path / "half" / "metrics.json").exists()
    resumed = start(tmp_path / "half", *arguments, small=False)
    assert resumed.status == 0, resumed.err
    assert resumed.values == expected.values
    assert contents(tmp_path / "half") == contents(tmp_path / "whole")
    assert not (tmp_path / "half" / "checkpoint").exists()


def test_chunks_are_kept_and_what_is_done_is_not_done_again(start, half, whole):
    """The memory now holds both sequences, which would be rounded otherwise."""
    assert {path.name for path in (half.directory / "checkpoint").iterdir()} == {
        "plan.pt",
        "0-0.pt",
        "1-1.pt",
    }
    seen, observe = [], LiveReport.__call__

    def seeing(self, step, state, estimate, sequences):
        seen.append((sequences.start, step))
        observe(self, step, state, estimate, sequences)

    with mock.patch.object(LiveReport, "__call__", seeing):
        resumed = start(half.directory, "runs=2", "memory_gb=9")
    assert seen == [(0, 4), (1, 2), (1, 3), (1, 4)]
    assert contents(resumed.directory) == contents(whole.directory)


def test_events_go_on(start, tmp_path):
    """Those of the first sequence; steps after the last checkpoint are not shown twice."""
    observe, arguments = (
        LiveReport.__call__,
        ("runs=2", ALONE, "logging.tensorboard=true", "logging.interval=2"),
    )

    def stopping(self, step, state, estimate, sequences):
        observe(self, step, state, estimate, sequences)
        self.flush()
        if step == 3:
            raise RuntimeError("stopped")

    with mock.patch.object(LiveReport, "__call__", stopping):
        assert start(tmp_path / "half", *arguments).status == 1
    for name in ("half", "whole"):
        assert start(tmp_path / name, *arguments).status == 0
    found, expected = (
        EventAccumulator(str(tmp_path / name / "tensorboard"), size_guidance=ALL).Reload()
        for name in ("half", "whole")
    )
    assert found.Tags() == expected.Tags()
    for tag in ("gospa/total", "log_evidence", "count/declared", "noise_db/tone_1"):
        rows = [[(event.step, event.value) for event in run.Scalars(tag)] for run in (found, expected)]
        assert rows[0] == rows[1]
        assert len(rows[0]) == 5
    steps = [[event.step for event in run.Histograms("belief/existence")] for run in (found, expected)]
    assert steps == [[0, 2, 4]] * 2


def test_events_are_there_before_the_checkpoint(start, tmp_path):
    """They are written by a thread, slow here, which `flush` waits for."""
    save, flush, add, write = (
        keeper.save_checkpoint,
        LiveReport.flush,
        SummaryWriter.add_scalar,
        RecordWriter.write,
    )
    added, done = set(), []

    def note_and_add(self, tag, value, step):
        added.add((tag, step))
        add(self, tag, value, step)

    def write_slowly(self, data):
        time.sleep(0.002)
        write(self, data)

    def flush_and_look(self):
        flush(self)
        events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
        found = {(tag, event.step) for tag in events.Tags()["scalars"] for event in events.Scalars(tag)}
        done.append((found == added, len({step for _, step in found})))

    def note_and_save(path, *arguments):
        done.append(path.name)
        save(path, *arguments)

    with (
        mock.patch.object(SummaryWriter, "add_scalar", note_and_add),
        mock.patch.object(RecordWriter, "write", write_slowly),
        mock.patch.object(LiveReport, "flush", flush_and_look),
        mock.patch.object(keeper, "save_checkpoint", note_and_save),
    ):
        start(tmp_path, "logging.tensorboard=true")
    assert done[0] == "plan.pt"
    assert done[1::2] == [(True, k + 1) for k in range(5)]
    assert done[2::2] == ["0-0.pt"] * 5


def test_a_finished_run_is_left_alone(start, whole):
    names = [path.name for path in whole.directory.iterdir() if path.is_file() and path.name != "track.log"]
    before, figures = untouched(whole.directory, *names), sorted(whole.directory.rglob("*.*"))
    with mock.patch.object(track, "set_up", side_effect=AssertionError("computed")):
        again = start(whole.directory, "runs=2", "memory_gb=9", "threads=1", "workers=1", "logging=default")
    assert again.status == 0, again.err
    assert again.values == whole.values
    assert untouched(whole.directory, *names) == before
    assert sorted(whole.directory.rglob("*.*")) == figures
    assert again.log.count("finished before, nothing to do") == 1


def test_a_finished_run_whose_tables_are_gone_is_run_again(start, tmp_path, whole):
    arguments = (tmp_path, "runs=2", ALONE)
    assert start(*arguments).status == 0
    (tmp_path / "gospa.csv").unlink()
    again = start(*arguments)
    assert again.status == 0, again.err
    assert "finished before, but without gospa.csv now: running again" in again.log
    assert contents(tmp_path) == contents(whole.directory)
    assert "nothing to do" in start(*arguments).log


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["seed=1"], "key 'seed': found 1, expected 0, as in"),
        (["tracker=mp_bp", "runs=2"], "key 'tracker': found mp_bp, expected direct, as in"),
        (["model.survival=0.9"], "key 'model.survival': found 0.9, expected 0.95, as in"),
        (["scenario.num_steps=6"], "key 'scenario.num_steps': found 6, expected 5, as in"),
        (["dtype=float64"], "key 'dtype': found float64, expected float32, as in"),
        (["runs=1"], "key 'runs': found 1, expected 2, as in"),
        (["variants=[{survival: 0.9}]"], "key 'variants': found [{'survival': 0.9}], expected None, as in"),
    ],
)
def test_another_run_is_refused(start, whole, overrides, words):
    small = () if "tracker=mp_bp" not in overrides else (*LINE, *POINTS)
    before = untouched(whole.directory, *KEPT)
    other = start(whole.directory, "runs=2", *small, *overrides, small=not small)
    assert other.status == 1
    assert words in other.err
    assert f"as in {whole.directory / 'checkpoint.pt'}; another folder starts anew" in other.err
    assert untouched(whole.directory, *KEPT) == before


def test_another_run_does_not_go_on(start, half):
    before = {path: path.read_bytes() for path in (half.directory / "checkpoint").iterdir()}
    other = start(half.directory, "runs=2", "seed=1")
    assert "key 'seed': found 1, expected 0, as in" in other.err
    assert {path: path.read_bytes() for path in (half.directory / "checkpoint").iterdir()} == before


def test_other_data_under_the_same_name(start, tmp_path, recording):
    path, directory = tmp_path / "data.npz", tmp_path / "run"
    write_npz(path, recording)
    arguments = (directory, "data=npz", f"data.path={path}")
    assert start(*arguments).status == 0
    before = untouched(directory, *KEPT)
    recording.snapshots[0, 0, 0, 0, 0] *= 2
    write_npz(path, recording)
    recording.snapshots[0, 0, 0, 0, 0] /= 2
    other = start(*arguments)
    assert other.status == 1
    assert f"key 'content of {path}': found" in other.err
    path.unlink()
    gone = start(*arguments)
    assert f"key 'content of {path}': found no file, expected" in gone.err
    assert untouched(directory, *KEPT) == before


def test_the_checkpoint_of_another_job(start, tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, "tune", {}, {})
    outcome = start(tmp_path)
    assert outcome.status == 1
    assert f"path '{path}': found a checkpoint of 'tune', expected one of 'track'" in outcome.err
    assert not (tmp_path / "manifest.json").exists()


@pytest.mark.parametrize("name", ["checkpoint.pt", "checkpoint/1-1.pt"])
def test_part_of_a_checkpoint(start, half, name):
    path = half.directory / name
    content = path.read_bytes()
    path.write_bytes(content[: random.Random(3).randrange(len(content))])
    outcome = start(half.directory, "runs=2", ALONE)
    assert outcome.status == 1
    assert f"path '{path}': found a file of another kind, or part of one" in outcome.err


def test_results_that_are_not_all_written(start, tmp_path, whole):
    """Tracked to the end, and killed before the last table."""
    arguments = (tmp_path, "runs=2", ALONE, "logging=default")
    with mock.patch.object(track, "write_gospa_csv", side_effect=RuntimeError("killed")):
        assert start(*arguments).status == 1
    written = (tmp_path / "metrics.json").read_bytes()
    with mock.patch("torchdt.filter.direct.DirectTracker.step", side_effect=AssertionError("tracked")):
        again = start(*arguments)
    assert again.status == 0, again.err
    assert again.values == whole.values
    assert contents(tmp_path) == contents(whole.directory)
    assert (tmp_path / "metrics.json").read_bytes() != written  # more time has passed
    assert (tmp_path / "figures" / "tracks.png").exists()


def test_time_counts_all_processes(start, half):
    spent = torch.load(half.directory / "checkpoint" / "1-1.pt", weights_only=True)["content"]["seconds"]
    resumed = start(half.directory, "runs=2", ALONE)
    assert resumed.json("metrics.json")["seconds"] > spent > 0


def test_without_a_checkpoint_a_run_begins_anew(start, tmp_path):
    first = start(tmp_path, "checkpoint_s=null")
    assert {path.name for path in tmp_path.iterdir()} == {
        ".hydra",
        "track.log",
        "manifest.json",
        "metrics.json",
        "tracks.csv",
        "gospa.csv",
    }
    second = start(tmp_path, "checkpoint_s=null", "seed=4")
    assert second.status == 0, second.err
    assert second.json("metrics.json")["seed"] == 4
    assert second.values != first.values


def test_an_interrupted_run_goes_on_without_further_checkpoints(start, half, whole):
    resumed = start(half.directory, "runs=2", ALONE, "checkpoint_s=null")
    assert contents(resumed.directory) == contents(whole.directory)
    with mock.patch.object(track, "set_up", side_effect=AssertionError("computed")):
        assert start(half.directory, "runs=2").values == whole.values


def test_a_full_disk(start, tmp_path, whole):
    arguments = (tmp_path, "runs=2", ALONE)
    folder = tmp_path / "checkpoint"
    with full_disk(lambda: (folder / "1-1.pt").exists()):
        outcome = start(*arguments)
    assert outcome.status == 1
    assert outcome.err == f"cannot write {folder / '1-1.pt'}: No space left on device\n"
    assert {path.name for path in folder.iterdir()} == {"plan.pt", "0-0.pt", "1-1.pt"}
    assert start(*arguments).status == 0
    assert contents(tmp_path) == contents(whole.directory)


@pytest.mark.parametrize("name", ["checkpoint", "tensorboard", "figures"])
def test_a_file_in_the_place_of_a_folder(start, tmp_path, whole, name):
    arguments = (tmp_path, "runs=2", ALONE, "logging=default")
    (tmp_path / name).write_bytes(b"")
    outcome = start(*arguments)
    assert outcome.status == 1
    assert outcome.err.startswith(f"cannot write {tmp_path / name}: ")
    assert outcome.err.count("\n") == 1
    (tmp_path / name).unlink()
    assert start(*arguments).status == 0
    assert contents(tmp_path) == contents(whole.directory)


def test_a_repeated_sweep_does_what_is_left(launch, tmp_path):
    sweep = ("-m", "seed=0,1,2", ALWAYS, f"hydra.sweep.dir={tmp_path}")
    expected = launch("-m", "seed=0,1,2")
    failing, run = [], track.track_in_chunks

    def failing_once(settings, *arguments):
        if settings.seed == 1:
            failing.append(1)
            with stopped(0, 3):
                return run(settings, *arguments)
        return run(settings, *arguments)

    with mock.patch.object(track, "track_in_chunks", failing_once):
        assert launch(*sweep).status == 1
    assert failing == [1]
    done = [untouched(tmp_path / str(job), *KEPT) for job in (0, 2)]
    with mock.patch.object(track, "set_up", wraps=track.set_up) as set_up:
        again = launch(*sweep)
    assert again.status == 0, again.err
    assert [call.args[0].seed for call in set_up.call_args_list] == [1]
    assert again.values == expected.values
    assert [untouched(tmp_path / str(job), *KEPT) for job in (0, 2)] == done
    for job in range(3):
        assert contents(tmp_path / str(job)) == contents(expected.directory / str(job))


def test_killed_twice_at_random(start, tmp_path):
    """At once, or up to half the time of a sequence, after each has its first checkpoint."""
    long = ("runs=2", ALONE, "scenario.num_steps=40")
    expected = start(tmp_path / "whole", *long)
    longest = expected.json("metrics.json")["seconds"] / 4
    directory, killed = tmp_path / "killed", []
    command = [sys.executable, FOLDER / "track.py", "logging=quiet", *SMALL, *LINE, *long, ALWAYS]
    environment = os.environ | {"OMP_NUM_THREADS": str(torch.get_num_threads())}  # rounds alike
    for name in ("0-0.pt", "1-1.pt"):
        path = directory / "checkpoint" / name
        with subprocess.Popen([*command, f"hydra.run.dir={directory}"], env=environment) as process:
            while not path.exists():
                assert process.poll() is None
                time.sleep(0.01)
            delay = random.SystemRandom().uniform(0, longest)
            time.sleep(delay)
            process.kill()
        assert process.returncode == -signal.SIGKILL
        steps = torch.load(path, weights_only=True)["content"]["history"][0].shape[1]
        killed.append(f"{delay:.3f} s after {name} appeared, {steps} steps kept")
    resumed = start(directory, *long)
    assert resumed.status == 0, resumed.err
    assert resumed.values == expected.values, killed
    assert contents(directory) == contents(tmp_path / "whole"), killed
