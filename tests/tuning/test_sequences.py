import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.data.recording import validate
from torchdt.tuning.sequences import stack_recordings


def recording(steps=3, truth=1, runs=1, **changes):
    generator = torch.Generator().manual_seed(steps)
    data = torch.randn(runs, steps, 2, 3, 4, generator=generator, dtype=torch.complex64)
    position = torch.arange(runs * steps * truth).double().reshape(runs, steps, truth, 1)
    given = {"step_s": 1.0, "snapshots": data, "truth": None if truth == 0 else position}
    return validate(**(given | changes))


def test_equal_lengths():
    first, second = recording(runs=2), recording(start_s=60.0)
    batch, mask = stack_recordings([first, second])
    assert torch.equal(batch.snapshots, torch.cat([first.snapshots, second.snapshots]))
    assert torch.equal(batch.truth, torch.cat([first.truth, second.truth]))
    assert batch.times()[:, 0].tolist() == [0.5, 0.5, 60.5]
    assert mask.shape == (3, 3)
    assert mask.all()


def test_unequal_lengths():
    parts = [recording(3), recording(5, runs=2)]
    with pytest.raises(InputError, match=r"found lengths \[3, 5\], expected equal numbers of steps, or pad"):
        stack_recordings(parts)
    batch, mask = stack_recordings(parts, pad=True)
    assert mask.tolist() == [[True] * 3 + [False] * 2, [True] * 5, [True] * 5]
    assert torch.equal(batch.snapshots[0, :3], parts[0].snapshots[0])
    assert batch.snapshots[0, 3:].isnan().all()
    assert batch.truth[0, 3:].isnan().all()
    assert torch.equal(batch.snapshots[1:], parts[1].snapshots)


def test_covariances():
    matrix = torch.eye(4, dtype=torch.complex64).expand(1, 3, 2, 4, 4)
    parts = [validate(step_s=1.0, covariance=matrix[:, :k], num_snapshots=7) for k in (3, 2)]
    batch, mask = stack_recordings(parts, pad=True)
    assert torch.equal(batch.covariance[0], matrix[0])
    assert batch.covariance[1, 2].isnan().all()
    assert batch.num_snapshots == 7
    assert mask.sum() == 5


def test_different_numbers_of_objects():
    batch, _ = stack_recordings([recording(truth=1), recording(truth=3)])
    assert batch.truth.shape == (2, 3, 3, 1)
    assert batch.truth_mask.sum(-1).tolist() == [[1] * 3, [3] * 3]


def test_truth_only_where_all_have_it():
    batch, _ = stack_recordings([recording(), recording(truth=0)])
    assert batch.truth is None


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"step_s": 2.0}, "step_s"),
        ({"span_s": 2.0}, "span_s"),
        ({"freqs": torch.tensor([1.0, 2.0])}, "freqs"),
        ({"snapshots": torch.ones(1, 3, 2, 2, 4, dtype=torch.complex64)}, "snapshots"),
        ({"snapshots": torch.ones(1, 3, 2, 3, 5, dtype=torch.complex64)}, "snapshots"),
        (
            {
                "snapshots": None,
                "covariance": torch.ones(1, 3, 2, 4, 4, dtype=torch.complex64),
                "num_snapshots": 2,
            },
            "recordings",
        ),
    ],
)
def test_recordings_that_do_not_fit(changes, key):
    with pytest.raises(InputError, match=f"key '{key}': found .* and "):
        stack_recordings([recording(), recording(**changes)])


def test_no_recordings():
    with pytest.raises(InputError, match="key 'recordings': found none"):
        stack_recordings([])
