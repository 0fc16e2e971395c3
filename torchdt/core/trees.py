"""Rows of tensors and of tuples of tensors: one slot of every sequence, or some sequences of a batch."""

from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import torch
from torch import Tensor


def take(tensor: Tensor, index: Tensor) -> Tensor:
    """Entry `index` of dimension `index.ndim`, per batch element: `(*batch, N, ...)` to `(*batch, ...)`."""
    rows = tensor.flatten(0, index.ndim)
    if index.numel() == 1 and index.device.type == "cpu":
        row = rows[int(index)]  # without a copy
    else:
        row = rows.index_select(0, _row(tensor, index))
    return row.reshape((*index.shape, *tensor.shape[index.ndim + 1 :]))


def put(tensor: Tensor, index: Tensor, value: Tensor) -> Tensor:
    """The inverse of `take`, out of place."""
    shape = tensor.shape[index.ndim + 1 :]
    rows = value.expand((*index.shape, *shape)).reshape((index.numel(), *shape))
    return tensor.flatten(0, index.ndim).index_copy(0, _row(tensor, index), rows).reshape(tensor.shape)


def _row(tensor: Tensor, index: Tensor) -> Tensor:
    """Where the entries are once batch and slots are one dimension: whole rows are copied faster so."""
    row = index.reshape(-1)
    if len(row) > 1:
        row = row + tensor.shape[index.ndim] * torch.arange(len(row), device=row.device)
    return row


Tree = TypeVar("Tree", bound=tuple[Any, ...])


def select(condition: Tensor, first: Tree, second: Tree) -> Tree:
    """Take each batch element from one of two (nested) tuples of tensors `(*batch, ...)`."""

    def choose(a: Any, b: Any) -> Any:
        if isinstance(a, Tensor):
            return torch.where(
                condition.reshape(*condition.shape, *(1 for _ in a.shape[condition.ndim :])), a, b
            )
        return a if a is None else type(a)(*(choose(x, y) for x, y in zip(a, b, strict=True)))

    return choose(first, second)


def take_sequences(tree: Tree, rows: Tensor) -> Tree:
    """Sequences of a (nested) tuple of tensors `(B, ...)`, `(B',)` int64."""
    parts = (t if t is None else t[rows] if isinstance(t, Tensor) else take_sequences(t, rows) for t in tree)
    return _rebuild(tree, parts)


def put_sequences(tree: Tree, rows: Tensor, part: Tree) -> Tree:
    """The inverse of `take_sequences`, out of place."""

    def put_one(old: Any, new: Any) -> Any:
        if isinstance(old, Tensor):
            return old.index_copy(0, rows, new)
        return old if old is None else put_sequences(old, rows, new)

    return _rebuild(tree, (put_one(old, new) for old, new in zip(tree, part, strict=True)))


def join_sequences(trees: Sequence[Tree]) -> Tree:
    """(Nested) tuples of tensors `(B', ...)` one after another, `(B, ...)`."""
    parts = (
        torch.cat(part) if isinstance(part[0], Tensor) else join_sequences(part)
        for part in zip(*trees, strict=True)
    )
    return _rebuild(trees[0], parts)


def _rebuild(tree: Tree, parts: Iterable[Any]) -> Tree:
    """A named tuple, or a plain one, of other parts."""
    return type(tree)(*parts) if hasattr(tree, "_fields") else type(tree)(parts)
