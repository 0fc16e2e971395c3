"""Rows of tensors, and trees of tensors: (nested) tuples, whose leaves are treated alike."""

import itertools
from collections.abc import Callable, Sequence
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


def tree_map(function: Callable[..., Tensor], tree: Tree, *others: Any) -> Tree:
    """Apply a function to the tensors in the same place of (nested) tuples alike; None stays None."""

    def apply(first: Any, *rest: Any) -> Any:
        if first is None:
            return None
        if not isinstance(first, tuple):
            return function(first, *rest)
        parts = itertools.starmap(apply, zip(first, *rest, strict=True))
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)

    return apply(tree, *others)


def select(condition: Tensor, first: Tree, second: Tree) -> Tree:
    """Take each batch element from one of two trees of tensors `(*batch, ...)`."""

    def choose(a: Tensor, b: Tensor) -> Tensor:
        wide = condition.reshape((*condition.shape, *(1 for _ in a.shape[condition.ndim :])))
        return torch.where(wide, a, b)

    return tree_map(choose, first, second)


def take_sequences(tree: Tree, rows: Tensor) -> Tree:
    """Sequences of a tree of tensors `(B, ...)`, `(B',)` int64."""
    return tree_map(lambda t: t[rows], tree)


def put_sequences(tree: Tree, rows: Tensor, part: Tree) -> Tree:
    """The inverse of `take_sequences`, out of place."""
    return tree_map(lambda old, new: old.index_copy(0, rows, new), tree, part)


def join(trees: Sequence[Tree], dim: int = 0) -> Tree:
    """Trees one after another in a dimension, such as sequences `(B', ...)` to `(B, ...)`."""
    return tree_map(lambda *parts: torch.cat(parts, dim), *trees)


def stack(trees: Sequence[Tree], dim: int) -> Tree:
    """Trees along a new dimension, such as steps."""
    return tree_map(lambda *parts: torch.stack(parts, dim), *trees)
