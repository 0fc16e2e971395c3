"""Wall-clock time, and what it depends on."""

import os
import time
from collections.abc import Callable, Mapping
from statistics import median
from typing import Any

import numpy as np
import torch

SIZE = 1024
"""Rows of the matrices whose product is the measure of a machine."""


def clock(call: Callable[[], Any], device: str | torch.device = "cpu") -> tuple[float, Any]:
    """Seconds until the device has done what a call asks of it, and what the call returns."""
    accelerated = torch.device(device).type != "cpu"
    if accelerated:
        torch.accelerator.synchronize()
    start = time.perf_counter()
    result = call()
    if accelerated:
        torch.accelerator.synchronize()
    return time.perf_counter() - start, result


def clock_in_turn(
    calls: Mapping[str, Callable[[], Any]], repeats: int, device: str | torch.device = "cpu"
) -> dict[str, list[float]]:
    """Seconds of several calls, one after another, over and over, so that other load hits all of them.

    Args:
        calls: by name; each is made once more before the clock runs, in every round, or it would pay for the
            threads that the last one has left spinning.
        repeats: rounds that count.
        device: on which the calls leave work.

    Returns:
        Of every call its `repeats` times, by round.
    """
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            call()
            taken[name].append(clock(call, device)[0])
    return taken


def product_gflops(square: Any, device: str | torch.device = "cpu") -> float:
    """Real floating-point operations per second, in 1e9, of a real `(n, n)` matrix times itself."""
    seconds = clock_in_turn({"product": lambda: square @ square}, 5, device)["product"]
    return 2e-9 * len(square) ** 3 / median(seconds)


def describe_machine(device: str) -> dict[str, object]:
    """What speeds depend on; rates are those of a product of two real matrices in single precision."""
    return {
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "device": device,
        "threads": torch.get_num_threads(),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "torch_sgemm_gflops": product_gflops(torch.ones(SIZE, SIZE, device=device), device),
        "numpy_sgemm_gflops": product_gflops(np.ones((SIZE, SIZE), dtype=np.float32)),
    }
