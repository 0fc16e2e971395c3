import time

import torch

from benchmarks.clock import clock, clock_in_turn, describe_machine


def test_the_clock_returns_what_was_asked():
    seconds, result = clock(lambda: time.sleep(0.01) or 7)
    assert seconds >= 0.01
    assert result == 7


def test_the_clock_takes_a_device_by_name_or_as_such():
    for device in ("cpu", torch.device("cpu")):
        assert clock(lambda: 7, device)[1] == 7


def test_calls_are_made_in_turn_each_after_one_that_does_not_count():
    made = []
    calls = {name: lambda name=name: made.append(name) or time.sleep(0.002) for name in "ab"}
    seconds = clock_in_turn(calls, 3)
    assert made == list("aabb" * 3)
    assert list(seconds) == ["a", "b"]
    assert all(len(taken) == 3 and min(taken) >= 0.002 for taken in seconds.values())


def test_the_machine_is_described():
    machine = describe_machine("cpu")
    assert (machine["torch"], machine["threads"]) == (torch.__version__, torch.get_num_threads())
    assert machine["device"] == "cpu"
    assert machine["cores"] >= 1
    assert min(machine["torch_sgemm_gflops"], machine["numpy_sgemm_gflops"]) > 0
