import builtins
import os
from types import SimpleNamespace

import pytest
import torch
from hydra import compose, initialize_config_module
from oracles.line_array import make_field, make_region, make_tracker, simulate

from torchdt.app import build
from torchdt.app.settings import settings_of
from torchdt.core import memory
from torchdt.core.errors import InputError
from torchdt.core.memory import free_memory_gb
from torchdt.data.recording import validate
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.run.track import track


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


def test_what_does_not_fit_is_refused_before_it_is_made(monkeypatch):
    """A dictionary, a sequence to track and a simulation, on a machine of a kilobyte."""
    recording = validate(step_s=1.0, snapshots=simulate(1, steps=2)[0])
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        settings = settings_of(compose("track", overrides=["scenario=line_array"]))
    monkeypatch.setattr(memory, "free_memory_gb", lambda device: 1e-6)
    with pytest.raises(InputError, match=r"'scenario.coordinates': found 70 cells of 2 tones.*1e-06 GB"):
        build_dictionary(make_field(), make_region())
    with pytest.raises(InputError, match=r"'tracker': found slots, particles and cells.* GB"):
        track(recording, make_tracker(), [0])
    with pytest.raises(InputError, match=r"'scenario.num_steps': found 1 runs of 60 steps"):
        build.simulate(settings)
