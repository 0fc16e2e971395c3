"""Moves of an intensity along its axes, against dense matrices and moments."""

import pytest
import torch

from torchdt.filter.intensity.transport import Kernel, carry, kernel, node_matrix

F64 = torch.float64


def moments(moves: Kernel) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean and variance of each row."""
    reach = moves.weight.shape[-1] // 2
    cell = torch.tensor(moves.offset)[:, None] + torch.arange(-reach, reach + 1)
    mean = (moves.weight * cell).sum(-1)
    return mean, (moves.weight * (cell - mean[..., None]).square()).sum(-1)


def dense(offset: int, weight: torch.Tensor, size: int, closed: bool) -> torch.Tensor:
    """`(size, size)` from one place to another."""
    matrix, reach = torch.zeros(size, size, dtype=weight.dtype), len(weight) // 2
    for start in range(size):
        for k, share in enumerate(weight):
            end = start + offset + k - reach
            if closed:
                matrix[start, end % size] += share
            elif 0 <= end < size:
                matrix[start, end] += share
    return matrix


@pytest.mark.parametrize("variance", [0.0, 0.01, 0.3, 0.5, 0.51, 2.0, 7.3])
def test_mean_and_variance_are_those_asked_for_or_the_least_that_cells_can_have(variance):
    shift = torch.tensor([0.0, 0.2, -0.49, 0.5, 3.7, -12.25, 1.0], dtype=F64)
    moves = kernel(shift, torch.tensor(variance, dtype=F64))
    assert (moves.weight > -1e-15).all()
    torch.testing.assert_close(moves.weight.sum(-1), torch.ones(7, dtype=F64))
    mean, found = moments(moves)
    between = shift - shift.floor()
    torch.testing.assert_close(mean, shift, rtol=0, atol=1e-12)
    expected = (between * (1 - between)).clamp_min(variance)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


def test_sequences_of_a_batch_move_as_they_do_alone():
    """Also where their shifts are cells apart, and their variances far."""
    rng = torch.Generator().manual_seed(0)
    shift = 5 * torch.randn(6, 3, generator=rng, dtype=F64)
    variance = 3 * torch.rand(6, 3, generator=rng, dtype=F64).square()
    values, together = torch.rand(6, 40, generator=rng, dtype=F64), kernel(shift, variance)
    torch.testing.assert_close(moments(together)[0], shift)
    for v in range(3):
        moved = carry(values, together.offset[v], together.weight[:, v], -1, True)
        for b in range(6):
            alone = kernel(shift[b], variance[b])
            expected = carry(values[b], alone.offset[v], alone.weight[v], -1, True)
            torch.testing.assert_close(moved[b], expected, rtol=1e-13, atol=1e-15)


def test_gradients_of_mean_and_variance():
    shift = torch.tensor([0.3, -2.2], dtype=F64, requires_grad=True)
    variance = torch.tensor([0.4, 1.7], dtype=F64, requires_grad=True)
    mean, found = moments(kernel(shift, variance))
    for value, of in ((mean, shift), (found, variance)):
        (slope,) = torch.autograd.grad(value.sum(), of, retain_graph=True)
        torch.testing.assert_close(slope, torch.ones(2, dtype=F64))


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("offset", [0, 2, -3, 9, -14])
@pytest.mark.parametrize("dim", [-1, -2])
def test_moves_are_those_of_a_matrix(dim, offset, closed):
    rng = torch.Generator().manual_seed(1)
    values = torch.rand(2, 5, 7, 7, generator=rng, dtype=F64)
    weight = torch.rand(2, 5, 3, generator=rng, dtype=F64).softmax(-1)
    found = carry(values, offset, weight, dim, closed)
    for b in range(2):
        for i in range(5):
            matrix = dense(offset, weight[b, i], 7, closed)
            expected = values[b, i] @ matrix if dim == -1 else matrix.mT @ values[b, i]
            torch.testing.assert_close(found[b, i], expected)


def test_what_passes_an_end_is_lost_and_what_goes_round_is_not():
    values, weight = torch.ones(10, dtype=F64), torch.tensor([0.25, 0.5, 0.25], dtype=F64)
    assert carry(values, 3, weight, -1, closed=False).sum().item() == pytest.approx(7.0)
    assert carry(values, 3, weight, -1, closed=True).sum().item() == pytest.approx(10.0)
    assert carry(values, 20, weight, -1, closed=False).eq(0).all()


def test_nodes_keep_their_mass():
    """What passes an end stays there; against one axis after the other."""
    rng = torch.Generator().manual_seed(2)
    shape = (3, 4)
    shift = 2 * torch.randn(2, 5, 12, generator=rng, dtype=F64)
    along = [kernel(row, torch.tensor(0.8, dtype=F64)) for row in shift]
    matrix = node_matrix(along, shape)
    assert matrix.shape == (5, 12, 12)
    torch.testing.assert_close(matrix.sum(-1), torch.ones(5, 12, dtype=F64))
    for b in range(5):
        for v in range(12):
            expected = torch.zeros(shape, dtype=F64)
            place, reach = (v // 4, v % 4), [m.weight.shape[-1] // 2 for m in along]
            for i, first in enumerate(along[0].weight[b, v]):
                for j, second in enumerate(along[1].weight[b, v]):
                    to_i = min(max(place[0] + along[0].offset[v] + i - reach[0], 0), 2)
                    to_j = min(max(place[1] + along[1].offset[v] + j - reach[1], 0), 3)
                    expected[to_i, to_j] += first * second
            torch.testing.assert_close(matrix[b, v], expected.flatten())
