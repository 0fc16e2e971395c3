"""Interrupted runs of `track` that the same command finishes, with the same numbers."""

import os
import random
import signal
import subprocess
import sys
import time
from unittest import mock

import pytest
import torch
from oracles.interrupted import ALL, ALONE, ALWAYS, KEPT, LINE, POINTS, contents, stopped, untouched
from oracles.scripts import FOLDER, SMALL
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard import SummaryWriter

from torchdt.app import track
from torchdt.app.live import LiveReport
from torchdt.data.npz import write_npz
from torchdt.run import keeper

pytestmark = pytest.mark.slow
# By name, and the sequence and step at which they stop.
CASES = {
    ("workers", 1, 3): (*SMALL, *LINE, "runs=2", "workers=2"),
    ("variants", 1, 2): (*SMALL, *LINE, "variants=[{{survival: 0.9}},{{survival: 0.99}}]", ALONE),
    ("npz", 1, 4): (*SMALL, *LINE, "data=npz", "data.path={folder}/two.npz", ALONE),
    ("mp_bp", 0, 0): (*LINE, "tracker=mp_bp", *POINTS, "runs=2", ALONE),
}


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


def test_a_finished_run_whose_tables_are_gone_is_run_again(start, finished, whole):
    arguments = (finished.directory, "runs=2", ALONE)
    (finished.directory / "gospa.csv").unlink()
    again = start(*arguments)
    assert again.status == 0, again.err
    assert "finished before, but without gospa.csv now: running again" in again.log
    assert contents(finished.directory) == contents(whole.directory)
    assert "nothing to do" in start(*arguments).log


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
        "energy.csv",
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


def test_a_repeated_sweep_does_what_is_left(launch, tmp_path):
    sweep = ("-m", "seed=0,1", ALWAYS, f"hydra.sweep.dir={tmp_path}")
    expected = launch("-m", "seed=0,1")
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
    done = untouched(tmp_path / "0", *KEPT)
    with mock.patch.object(track, "set_up", wraps=track.set_up) as set_up:
        again = launch(*sweep)
    assert again.status == 0, again.err
    assert [call.args[0].seed for call in set_up.call_args_list] == [1]
    assert again.values == expected.values
    assert untouched(tmp_path / "0", *KEPT) == done
    for job in range(2):
        assert contents(tmp_path / str(job)) == contents(expected.directory / str(job))


def test_killed_at_random(start, whole, tmp_path):
    """At once, or up to half the time of a sequence, after the first one has its first checkpoint."""
    longest = whole.json("metrics.json")["seconds"] / 4
    path = tmp_path / "checkpoint" / "0-0.pt"
    arguments = ("runs=2", ALONE)
    command = [sys.executable, FOLDER / "track.py", "logging=quiet", *SMALL, *LINE, *arguments, ALWAYS]
    environment = os.environ | {"OMP_NUM_THREADS": str(torch.get_num_threads())}  # rounds alike
    with subprocess.Popen([*command, f"hydra.run.dir={tmp_path}"], env=environment) as process:
        while not path.exists():
            assert process.poll() is None
            time.sleep(0.01)
        delay = random.SystemRandom().uniform(0, longest)
        time.sleep(delay)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    steps = torch.load(path, weights_only=True)["content"]["history"][0].shape[1]
    killed = f"{delay:.3f} s after the first checkpoint, {steps} steps kept"
    resumed = start(tmp_path, *arguments)
    assert resumed.status == 0, resumed.err
    assert resumed.values == whole.values, killed
    assert contents(tmp_path) == contents(whole.directory), killed
