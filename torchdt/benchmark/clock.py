"""Wall-clock time, and what it depends on."""

import os
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import torch


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


def describe_machine(device: str) -> dict[str, object]:
    """What speeds depend on; rates are those of a product of two real matrices in single precision."""
    size = 1024
    square = torch.ones(size, size, device=device)
    array = np.ones((size, size), dtype=np.float32)
    rates = {}
    for name, product in (("torch", lambda: square @ square), ("numpy", lambda: array @ array)):
        product()
        rates[name] = 2e-9 * size**3 / median(clock(product, device)[0] for _ in range(5))
    return {
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "device": device,
        "threads": torch.get_num_threads(),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "torch_sgemm_gflops": rates["torch"],
        "numpy_sgemm_gflops": rates["numpy"],
    }
