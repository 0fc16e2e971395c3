import pytest
import torch

from torchdt.history import TrackHistory
from torchdt.metrics import gospa

B, K, N, I, L = 2, 6, 3, 2, 2  # noqa: E741
STEP_S = 4.096


@pytest.fixture
def times():
    return torch.arange(K, dtype=torch.float64) * STEP_S


@pytest.fixture
def truth():
    truth = torch.zeros(B, K, L, 2, dtype=torch.float64)
    truth[:, :, 0] = torch.tensor([3000.0, 54.0])
    truth[:, :, 1] = torch.tensor([1500.0, 20.0])
    truth[:, :3, 1] = torch.nan  # the second object is born at step 3
    return truth


@pytest.fixture
def history():
    """Slot 0 follows the first object 1 m off; slot 1 is a ghost of run 1 at step 2; slot 2 is empty."""
    declared = torch.zeros(B, K, N, dtype=torch.bool)
    declared[:, :, 0] = True
    declared[1, 2, 1] = True
    label = torch.zeros(B, K, N, dtype=torch.int64)
    label[:, :, 0] = 3
    label[1, 2:, 1] = 12
    state = torch.zeros(B, K, N, 4)
    state[:, :, 0] = torch.tensor([3001.0, 54.0, -2.25, 0.1])
    state[:, :, 1] = torch.tensor([700.0, 90.0, 0.0, 0.0])
    return TrackHistory(
        existence=torch.where(declared, 0.987654321, 0.01),
        declared=declared,
        label=label,
        state=state,
        power=torch.tensor([10.0, 1000.0]).expand(B, K, N, I).clone(),
        noise=torch.tensor([1.0, 0.01]).expand(B, K, I).clone(),
        effective_sample_size=torch.full((B, K, N), 80.0),
        log_evidence=torch.tensor([[-1.5], [-2.5]]).expand(B, K).clone(),
    )


@pytest.fixture
def score(history, truth):
    return gospa(history.position, history.declared, truth, ~truth.isnan().any(-1), cutoff=200.0)
