import pytest
import torch
from oracles.arrays import complex_normal

from torchdt.core.errors import InputError
from torchdt.data.signals.static_copy import add_static_copy

K = 5


@pytest.fixture
def snapshots():
    return complex_normal(torch.Generator().manual_seed(0), K, 2, 3, 4)


def test_the_copy_is_stronger_by_the_gain(snapshots):
    both, _ = add_static_copy(snapshots, None, 2, -3.0)
    for step in range(K):
        moving = both[step] - snapshots[2]
        ratio = moving.abs().square().sum() / snapshots[step].abs().square().sum()
        assert 10 * ratio.log10() == pytest.approx(-3.0)
        torch.testing.assert_close(moving, snapshots[step] * ratio.sqrt())


def test_truth_of_the_copy_stands_still(snapshots):
    truth = torch.arange(K * 2 * 2, dtype=torch.float64).reshape(K, 2, 2)
    truth[:3, 1] = torch.nan  # absent at the step that is copied
    _, both = add_static_copy(snapshots, truth, 2, -3.0)
    assert both.shape == (K, 4, 2)
    torch.testing.assert_close(both[:, :2], truth, equal_nan=True)
    assert (both[:, 2] == truth[2, 0]).all()
    assert both[:, 3].isnan().all()


@pytest.mark.parametrize("step", [-1, K])
def test_no_such_step(snapshots, step):
    with pytest.raises(InputError, match=f"'data.static_copy.step': found {step}, expected 0 to 4"):
        add_static_copy(snapshots, None, step, 0.0)
