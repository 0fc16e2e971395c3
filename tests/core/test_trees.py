"""Rows of tensors and of tuples of tensors."""

import numpy as np
import pytest
import torch

from torchdt.core.trees import put, put_sequences, take, take_sequences, tree_map
from torchdt.model.prior import Priors


@pytest.mark.parametrize("index", [torch.tensor(2), torch.tensor([0, 3]), torch.tensor([[1], [2]])])
@pytest.mark.parametrize("rest", [(), (3,), (2, 5)])
def test_take_and_put_are_inverse(index, rest):
    tensor = torch.randn(*index.shape, 4, *rest, generator=torch.Generator().manual_seed(1))
    taken = take(tensor, index)
    assert taken.shape == (*index.shape, *rest)
    for at in np.ndindex(*index.shape):
        assert torch.equal(taken[at], tensor[at][index[at]])
    assert torch.equal(put(tensor, index, taken), tensor)
    changed = put(tensor, index, taken + 1)
    torch.testing.assert_close(take(changed, index), taken + 1)
    assert int((changed != tensor).sum()) == taken.numel()


def test_some_sequences_of_nested_tuples():
    tree = (Priors(torch.arange(4.0), torch.arange(8.0).reshape(4, 2)), None, torch.arange(4))
    rows = torch.tensor([3, 1])
    part = take_sequences(tree, rows)
    assert isinstance(part[0], Priors)
    assert part[0].power_max.tolist() == [3.0, 1.0]
    assert part[1] is None
    assert part[2].tolist() == [3, 1]
    doubled = (Priors(*(10 * t for t in part[0])), None, 10 * part[2])
    changed = put_sequences(tree, rows, doubled)
    assert changed[0].noise_max.tolist() == [[0.0, 1.0], [20.0, 30.0], [4.0, 5.0], [60.0, 70.0]]
    assert changed[2].tolist() == [0, 10, 2, 30]
    assert tree[2].tolist() == [0, 1, 2, 3], "out of place"


class FirstPriors(Priors):
    """A subclass of a named tuple."""


def test_tuples_of_all_kinds_stay_what_they_are():
    one = torch.ones(2)
    tree = (FirstPriors(one, 2 * one), (one, (None, Priors(one, one))))
    mapped = tree_map(torch.add, tree, tree)
    first, (second, (nothing, last)) = mapped
    assert [type(part) for part in (mapped, first, mapped[1], last)] == [tuple, FirstPriors, tuple, Priors]
    assert (first.noise_max.tolist(), second.tolist(), nothing) == ([4.0, 4.0], [2.0, 2.0], None)


def test_trees_that_differ_do_not_match():
    one = torch.ones(2)
    with pytest.raises(ValueError, match="shorter"):
        tree_map(torch.add, (one, one), (one,))
