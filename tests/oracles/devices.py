"""Traps for tensors whose device or type nobody named: they would be the CPU's, or the default's."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

import torchdt

FACTORIES = {
    torch.arange,
    torch.as_tensor,
    torch.asarray,
    torch.empty,
    torch.eye,
    torch.full,
    torch.linspace,
    torch.logspace,
    torch.ones,
    torch.rand,
    torch.randint,
    torch.randn,
    torch.randperm,
    torch.scalar_tensor,
    torch.tensor,
    torch.tril_indices,
    torch.triu_indices,
    torch.zeros,
}


class NamedDevices(TorchFunctionMode):
    """Inside it a factory call from files of a folder that leaves the device to the default is an error.

    Making the default another device instead would miss indices, which PyTorch takes from there.

    Args:
        folder: whose files are watched.
    """

    def __init__(self, folder: Path = Path(torchdt.__file__).parent):
        super().__init__()
        self.folder = folder

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: tuple = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        kwargs = kwargs or {}
        caller = sys._getframe(1)
        watched = Path(caller.f_code.co_filename).is_relative_to(self.folder)
        inherits = bool(args) and isinstance(args[0], Tensor)  # as_tensor of a tensor
        if watched and func in FACTORIES and not inherits and kwargs.get("device") is None:
            place = f"{caller.f_code.co_filename}:{caller.f_lineno}"
            raise AssertionError(f"{place}: {func.__name__} names no device")
        return func(*args, **kwargs)


@contextmanager
def default_dtype(dtype: torch.dtype) -> Iterator[None]:
    """Another default type for a while."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


@contextmanager
def foreign_defaults(dtype: torch.dtype) -> Iterator[None]:
    """No default device, and as the default type the other one of single and double precision."""
    with default_dtype(torch.float64 if dtype == torch.float32 else torch.float32), NamedDevices():
        yield


def tensors(tree: Any, name: str = "") -> Iterator[tuple[str, Tensor]]:
    """All tensors of nested tuples and of what torchdt's objects hold, with the path to each."""
    if isinstance(tree, Tensor):
        yield name, tree
    elif isinstance(tree, tuple | list):
        keys = getattr(tree, "_fields", range(len(tree)))
        for key, value in zip(keys, tree, strict=True):
            yield from tensors(value, f"{name}.{key}")
    elif isinstance(tree, dict):
        for key, value in tree.items():
            yield from tensors(value, f"{name}.{key}")
    elif type(tree).__module__.startswith("torchdt."):
        yield from tensors(vars(tree), name)


def assert_kind(tree: Any, dtype: torch.dtype, device: str = "cpu") -> None:
    """Every tensor is on the device; those that are not whole numbers or truth values have the type."""
    found = list(tensors(tree))
    assert found
    for name, value in found:
        assert value.device.type == device, f"{name}: {value.device}"
        expected = dtype.to_complex() if value.is_complex() else dtype
        whole = value.dtype in (torch.int64, torch.bool)
        assert whole or value.dtype == expected, f"{name}: {value.dtype}, expected {expected}"
