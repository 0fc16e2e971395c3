import pytest
import torch

from torchdt.filter.history import TrackHistory
from torchdt.filter.state import Objects, TrackerState
from torchdt.metrics import gospa
from torchdt.model.noise.base import Noise

B, K, N, I, L = 2, 6, 3, 2, 2  # noqa: E741
P, G = 40, 3
STEP_S = 4.096


@pytest.fixture
def times():
    """The second run begins a minute later."""
    return torch.tensor([[0.0], [60.0]]) + torch.arange(K, dtype=torch.float64) * STEP_S


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
        transmission=torch.where(declared, 0.75, 1.0),
        declared=declared,
        label=label,
        position=state[..., :2],
        state=state,
        state_std=torch.tensor([2.0, 0.5, 0.25, 0.125]).expand_as(state).clone(),
        power=torch.tensor([10.0, 1000.0]).expand(B, K, N, I).clone(),
        noise=torch.tensor([1.0, 0.01]).expand(B, K, I).clone(),
        shares=torch.tensor([0.5, 0.25, 0.125, 0.125]).expand(B, K, I, 4).clone(),
        effective_sample_size=torch.full((B, K, N), 80.0),
        failed=torch.zeros(B, K, dtype=torch.bool),
        log_evidence=torch.tensor([[-1.5], [-2.5]]).expand(B, K).clone(),
    )


@pytest.fixture
def score(history, truth):
    return gospa(history.position, history.declared, truth, ~truth.isnan().any(-1), cutoff=200.0)


@pytest.fixture
def state(history):
    """After step 2 of run 1, of a tracker whose unit of power is a hundred of the recording's."""
    estimate = history.select(1).steps(0)[2]
    offset = torch.randn(N, P, 4, generator=torch.Generator().manual_seed(0)) * torch.tensor(
        [2.0, 1, 0.1, 0.1]
    )
    shape = torch.tensor([0.5, 1.0, 2.0])
    weight = torch.tensor([0.4, 0.4, 0.2])  # the mean of the shape is one
    objects = Objects(
        state=estimate.state[:, None] + offset,
        log_weight=torch.rand(N, P, generator=torch.Generator().manual_seed(1)).log_softmax(-1),
        power=estimate.power[..., None] / 100 * shape,
        log_power_weight=weight.log().expand(N, I, G),
        log_odds=estimate.existence.logit(),
        label=estimate.label,
        transmits=torch.ones(N, P),
    )
    noise = Noise(torch.ones(I, 1), torch.zeros(I, 1))
    return TrackerState(objects, noise, torch.tensor(13), torch.zeros(0), torch.zeros(0))
