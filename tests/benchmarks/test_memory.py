import subprocess
from unittest import mock

import pytest
from oracles.line_array import make_tracker, simulate
from oracles.scripts import SMALL

from benchmarks import memory
from torchdt.data.recording import validate
from torchdt.filter.proposal.adapted import Adapted

pytestmark = pytest.mark.slow


def test_the_memory_of_a_run_is_that_of_a_fresh_process():
    rows = memory.measure_run_memory(["scenario=line_array", "logging=quiet", *SMALL])
    peak, before = (row.value for row in rows)
    assert 20 < before < peak < 4096
    assert "scenario=line_array" in rows[0].note


def test_a_run_that_fails_is_an_error():
    fails = mock.patch.object(memory, "RUN", "raise SystemExit(3)")
    with fails, pytest.raises(subprocess.CalledProcessError, match="status 3"):
        memory.measure_run_memory([])


def test_growth_is_between_a_tenth_and_all_of_the_steps():
    tracker = make_tracker(particles=20, proposal=Adapted(rounds=1, round_size=16))
    prepared = tracker.prepare(validate(snapshots=simulate(0, steps=2)[0], step_s=1.0))
    rows = memory.measure_growth(tracker, prepared, 20)
    first, last, growth = (row.value for row in rows)
    assert [row.quantity for row in rows[:2]] == ["resident after 2 steps", "resident after 20 steps"]
    assert 20 < first < 4096
    assert growth == last - first
    assert abs(growth) < 100


def test_what_grows_is_seen():
    tracker = make_tracker(particles=20, proposal=Adapted(rounds=1, round_size=16))
    prepared = tracker.prepare(validate(snapshots=simulate(0, steps=2)[0], step_s=1.0))
    leak = "        kept = [*globals().get('kept', ()), torch.ones(2**18)]\n        if k + 1 == early:"
    leaking = memory.ONLINE.replace("        if k + 1 == early:", leak)
    with mock.patch.object(memory, "ONLINE", leaking):
        growth = memory.measure_growth(tracker, prepared, 20)[-1].value
    assert growth > 15  # 18 steps of 1 MiB
