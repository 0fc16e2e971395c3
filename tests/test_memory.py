import builtins
import os
from types import SimpleNamespace

import torch

from torchdt.memory import free_memory_gb


def test_free_memory_of_the_machine(monkeypatch):
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    cpu = torch.device("cpu")
    assert 0 < free_memory_gb(cpu) <= total

    def refuse(*args: object) -> None:
        raise FileNotFoundError

    monkeypatch.setattr(builtins, "open", refuse)
    assert free_memory_gb(cpu) == total


def test_free_memory_of_an_accelerator(monkeypatch):
    """What is free, and what PyTorch keeps without using it."""
    numbers = {"mem_get_info": (5e9, 9e9), "memory_reserved": 3e9, "memory_allocated": 1e9}
    module = SimpleNamespace(**{name: lambda device, value=value: value for name, value in numbers.items()})
    monkeypatch.setattr(torch, "get_device_module", lambda device: module)
    assert free_memory_gb(torch.device("cuda")) == 7
