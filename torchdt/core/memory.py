"""Memory of the machine and of its accelerators."""

import os
from typing import Any

import torch

from torchdt.core.errors import require


def require_memory(num_bytes: float, device: torch.device, key: str, found: str) -> None:
    """Refuse what is too large before anything of its size is made.

    Args:
        num_bytes: what it takes.
        device: where it would be.
        key: the setting at fault.
        found: what was asked for, in words.

    Raises:
        InputError: where a device has not as much memory free.
    """
    free = free_memory_gb(device)
    expected = f"what fits into the {free:.3g} GB of memory that are free"
    require(num_bytes <= 1e9 * free, key, f"{found}, which take {num_bytes / 1e9:.3g} GB", expected)


def free_memory_gb(device: torch.device) -> float:
    """Memory that a device can still give, in 1e9 bytes; that of the machine for a CPU and for `meta`."""
    module: Any = None if device.type in ("cpu", "meta") else torch.get_device_module(device)
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
