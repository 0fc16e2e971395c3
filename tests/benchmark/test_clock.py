import time

import torch

from torchdt.benchmark.clock import clock, describe_machine


def test_the_clock_returns_what_was_asked():
    seconds, result = clock(lambda: time.sleep(0.01) or 7)
    assert seconds >= 0.01
    assert result == 7


def test_the_clock_takes_a_device_by_name_or_as_such():
    for device in ("cpu", torch.device("cpu")):
        assert clock(lambda: 7, device)[1] == 7


def test_the_machine_is_described():
    machine = describe_machine("cpu")
    assert (machine["torch"], machine["threads"]) == (torch.__version__, torch.get_num_threads())
    assert machine["device"] == "cpu"
    assert machine["cores"] >= 1
    assert min(machine["torch_sgemm_gflops"], machine["numpy_sgemm_gflops"]) > 0
