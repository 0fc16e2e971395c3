"""Memory of the machine and of its accelerators."""

import os
from typing import Any

import torch


def free_memory_gb(device: torch.device) -> float:
    """Memory that a device can still give, in 1e9 bytes; that of the machine for a CPU."""
    module: Any = None if device.type == "cpu" else torch.get_device_module(device)
    if hasattr(module, "mem_get_info"):
        # What PyTorch keeps for later use is free to us.
        kept = module.memory_reserved(device) - module.memory_allocated(device)
        return (module.mem_get_info(device)[0] + kept) / 1e9
    try:
        with open("/proc/meminfo") as file:
            entries = dict(line.split(":") for line in file)
        # Unlike the pages that sysconf calls available, these include what caches would give back.
        return int(entries["MemAvailable"].split()[0]) * 1024 / 1e9
    except (OSError, KeyError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
