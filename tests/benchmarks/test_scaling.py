import math
from unittest import mock

import pytest
import torch
from oracles.line_array import make_tracker, simulate

from benchmarks import scaling
from torchdt.data.recording import validate
from torchdt.filter.proposal.adapted import Adapted

pytestmark = pytest.mark.slow
BASE = {"slots": 2, "particles": 20, "tones": 2, "sensors": 5, "snapshots": 3, "batch": 1, "sweeps": 1}


def test_the_exponent_is_that_of_a_power_law():
    assert scaling.fit_exponent([2, 4, 32], [3e-3 * n**1.5 for n in (2, 4, 32)]) == pytest.approx(1.5)


def test_small_sizes_do_not_count_for_the_exponent():
    rows = scaling.scaling_rows("tones", [1, 2, 4, 8, 16], [1.0, 1.0, 4.0, 16.0, 64.0], "update")
    assert [row.quantity for row in rows[:2]] == ["tones = 1", "tones = 2"]
    assert (rows[2].value, rows[2].unit, rows[2].note) == (4e3, "ms", "update")
    assert rows[-1].quantity == "exponent of tones"
    assert rows[-1].value == pytest.approx(2.0)
    assert "from 4" in rows[-1].note


def test_one_size_grows_at_a_time():
    def seconds(problem, repeats, device):
        assert (repeats, device) == (3, "cpu")
        asked.append(problem)
        return 1e-3 * problem["tones"] * problem["sensors"] ** 2

    asked = []
    with mock.patch.object(scaling, "time_update", seconds):
        rows = scaling.measure_update_scaling(BASE, {"tones": [1, 2, 4], "sensors": [8, 16, 32]}, 3, "cpu")
    assert asked[:3] == [BASE | {"tones": n} for n in (1, 2, 4)]
    assert asked[3:] == [BASE | {"sensors": n} for n in (8, 16, 32)]
    found = {row.quantity: row.value for row in rows}
    assert found["exponent of tones"] == pytest.approx(1.0)
    assert found["exponent of sensors"] == pytest.approx(2.0)
    assert found["tones = 4"] == pytest.approx(100.0)
    assert rows[0].note == "update; 2 slots, 20 particles, 5 sensors, 3 snapshots, 1 batch, 1 sweeps"


def test_what_is_timed_is_an_update_of_that_size():
    with mock.patch.object(scaling, "update", wraps=scaling.update) as update:
        seconds = scaling.time_update(BASE | {"batch": 3, "particles": 30}, 2, "cpu")
    assert 0 < seconds < math.inf
    assert update.call_count == 4, "each of two once more, to be warm"
    assert update.call_args.args[1].shape == (3, 2, 2, 30, 5)
    assert update.call_args.kwargs == {"sweeps": 1}


def test_tracking_is_timed_over_steps():
    tracker = make_tracker(particles=20, proposal=Adapted(rounds=1, round_size=16))
    snapshots = torch.stack([simulate(0, ((0.0, 0.0), (9.0, 0.0)), steps=4)[0]] * 2)
    recording = validate(snapshots=snapshots, step_s=1.0)
    with mock.patch.object(scaling, "track", wraps=scaling.track) as track:
        rows = scaling.measure_length_scaling(tracker, recording, [1, 2, 4], 1)
    sizes = [(call.args[0].batch_size, call.args[0].num_steps) for call in track.call_args_list]
    assert sizes == [(1, steps) for steps in (1, 1, 2, 2, 4, 4)], "each once more, to be warm"
    assert [row.quantity for row in rows] == ["steps = 1", "steps = 2", "steps = 4", "exponent of steps"]
    assert all(0 < row.value < math.inf for row in rows[:3])
    assert rows[0].note == "tracking, 4 slots, 20 particles"
