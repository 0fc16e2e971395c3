"""Powers that are sent or not: the chain against its closed form, and beliefs of zeros."""

import pytest
import torch
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.model.power.base import PowerModel, Switch
from torchdt.model.power.gamma import GammaPower
from torchdt.model.power.switched import SwitchedPower, SwitchedTones

F64 = torch.float64


def tensor(value: float) -> Tensor:
    return torch.tensor(value, dtype=F64)


def tones(falls: float = 0.1, resumes: float = 0.3, shape: float = 50.0) -> SwitchedTones:
    return SwitchedTones(tensor(shape), tensor(falls), tensor(resumes))


def sent(log_weight: Tensor) -> Tensor:
    return log_weight.exp().chunk(2, -1)[0].sum(-1)


def test_the_chain_is_that_of_two_states():
    """`P(u_k) = p + (1 - falls - resumes)^k (P(u_0) - p)`, p what it is in the long run."""
    switch, before = Switch(tensor(0.1), torch.tensor([0.3, 0.2], dtype=F64)), torch.rand(2, 3, dtype=F64)
    after = before
    for _ in range(5):
        after = switch.predict(after)
    falls, resumes = switch
    stationary = (resumes / (falls + resumes))[:, None]
    expected = stationary + (1 - falls - resumes)[:, None] ** 5 * (before - stationary)
    torch.testing.assert_close(after, expected)


def test_objects_are_switched_as_a_whole_by_one_model_alone():
    assert SwitchedPower(tensor(50.0), tensor(0.1), tensor(0.3)).switch == Switch(tensor(0.1), tensor(0.3))
    assert tones().switch is None
    assert GammaPower().switch is None
    assert isinstance(tones(), PowerModel)


def test_the_power_of_a_tone_is_that_of_the_gamma_chain_times_what_is_sent():
    model, plain = tones(), GammaPower(tensor(50.0))
    power, log_weight = model.newborn(torch.ones(4, dtype=F64), torch.full((4,), 9.0, dtype=F64), 6)
    level, log_level = plain.newborn(torch.ones(4, dtype=F64), torch.full((4,), 9.0, dtype=F64), 6)
    torch.testing.assert_close(power, torch.cat([level, torch.zeros_like(level)], -1))
    torch.testing.assert_close(log_weight.exp().sum(-1), log_level.exp().sum(-1))
    torch.testing.assert_close(sent(log_weight), 0.75 * log_level.exp().sum(-1))
    log_weight = log_weight - log_weight.logsumexp(-1, keepdim=True)
    log_level = log_level - log_level.logsumexp(-1, keepdim=True)
    # Silent for sure, as after data that say so: the level is kept.
    gone = log_weight.clone()
    gone[..., :6] = -torch.inf
    gone = gone - gone.logsumexp(-1, keepdim=True)
    for _ in range(3):
        power, gone = model.predict(power, gone)
        level, log_level = plain.predict(level, log_level)
    torch.testing.assert_close(power[..., :6], level)
    torch.testing.assert_close(power[..., 6:], torch.zeros_like(level))
    torch.testing.assert_close(sent(gone), torch.full((4,), 0.75 * (1 - 0.6**3), dtype=F64))
    torch.testing.assert_close(gone.exp().sum(-1), torch.ones(4, dtype=F64))


def test_gradients_reach_both_rates():
    def share(falls: Tensor, resumes: Tensor) -> Tensor:
        model = SwitchedTones(tensor(50.0), falls, resumes)
        power, log_weight = model.initial(torch.ones(2, dtype=F64), 4)
        return model.predict(power, log_weight)[1] + SwitchedPower(
            tensor(2.0), falls, resumes
        ).switch.predict(log_weight.exp())

    rates = [tensor(0.1).requires_grad_(), tensor(0.3).requires_grad_()]
    assert torch.autograd.gradcheck(share, rates)


@pytest.mark.parametrize("name", ["falls_silent", "resumes"])
@pytest.mark.parametrize("value", [0.0, 1.0, -0.1])
def test_rates_are_probabilities(name, value):
    with pytest.raises(InputError, match=f"model.power.{name}.*{value}"):
        SwitchedPower(**{name: value})
