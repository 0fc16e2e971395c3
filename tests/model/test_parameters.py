import numpy as np
import pytest
import torch
from oracles.line_array import make_region, make_tracker

from torchdt.core.errors import InputError
from torchdt.filter.config import TrackerConfig
from torchdt.model.hyperparameters import Hyperparameters, HyperparameterSettings
from torchdt.model.parameters import Parameters, default_parameters, stack_parameters, widen, with_values
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
VALUES = {
    "power_shape": 50.0,
    "noise_shape": 20.0,
    "survival": 0.9,
    "birth_mean": 0.1,
    "driving_variance": [1e-2, 1e-5],
    "likelihood_power": 0.7,
    "effective_count": 30.0,
}
TWO = [Coordinate(name, "m", 0, 10, 1, -1, 1, variance) for name, variance in (("x", 1e-2), ("y", 1e-4))]


def parameters(dtype: torch.dtype) -> Parameters:
    return Parameters(**{name: torch.tensor(value, dtype=dtype) for name, value in VALUES.items()})


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_defaults_are_those_of_configuration_and_region(dtype):
    config = TrackerConfig(power_shape=50.0, survival=0.9, likelihood_power=0.5)
    found = default_parameters(config, Region(TWO, dtype))
    assert {value.dtype for value in found.known().values()} == {dtype}
    assert found.effective_count is None
    expected = {"power_shape": 50.0, "noise_shape": 100.0, "survival": 0.9, "birth_mean": 1e-4}
    expected |= {"driving_variance": [1e-2, 1e-4], "likelihood_power": 0.5}
    assert set(found.known()) == set(expected)
    for name, value in found.known().items():
        torch.testing.assert_close(value, torch.tensor(expected[name], dtype=dtype), rtol=0, atol=0)


def test_the_driving_variance_of_the_configuration_comes_first():
    found = default_parameters(TrackerConfig(driving_variance=[3.0, 4.0]), Region(TWO))
    assert found.driving_variance.tolist() == [3.0, 4.0]


@pytest.mark.parametrize("driving", [[1e-3, 1e-3], [1e-3, 1e-3, 1e-3]])
def test_another_number_of_driving_variances_is_named(driving):
    expected = r"'tracker.driving_variance': found \[0.001.*\], expected one number for each of 1 coordinates"
    with pytest.raises(InputError, match=expected):
        default_parameters(TrackerConfig(driving_variance=driving), make_region())


@pytest.mark.parametrize(("batch", "dims"), [((), 1), ((), 2), ((3,), 1), ((2, 3), 2)])
def test_widened_values_broadcast_over_what_follows_the_batch(batch, dims):
    value = torch.randn(batch, generator=torch.Generator().manual_seed(1))
    wide = widen(value, dims)
    assert wide.shape == (*batch, *[1] * dims)
    following = torch.zeros(*batch, *[4] * dims)
    for at in np.ndindex(*batch):
        assert (wide + following)[at].eq(value[at]).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_values_enter_with_their_gradient(dtype):
    old = parameters(dtype)
    settings = {name: HyperparameterSettings() for name in VALUES}
    defaults = old._asdict() | {"tilt_deg": 0.5}
    module = Hyperparameters(settings | {"tilt_deg": HyperparameterSettings()}, defaults)
    with torch.no_grad():
        for raw in module.parameters():
            raw.add_(0.5)
    values = module()
    assert "tilt_deg" in values
    new = with_values(old, values)
    for name, value in new._asdict().items():
        assert value.dtype == dtype
        torch.testing.assert_close(value, values[name].to(dtype))
    (found,) = torch.autograd.grad(new.driving_variance.sum(), [module.get_parameter("driving_variance")])
    torch.testing.assert_close(found, values["driving_variance"].detach(), rtol=1e-6, atol=0)


def test_parameters_without_a_value_stay():
    old = parameters(F64)
    per_sequence = torch.tensor([0.5, 0.6, 0.7])
    new = with_values(old, {"survival": per_sequence})
    torch.testing.assert_close(new.survival, per_sequence.double())
    assert new._replace(survival=old.survival) == old


def test_some_sequences_have_their_numbers():
    shared = parameters(F64)
    assert shared.select(slice(1, 2)) == shared
    own = shared._replace(
        survival=torch.tensor([0.5, 0.6, 0.7]), driving_variance=torch.tensor([[1.0, 2], [3, 4], [5, 6]])
    )
    part = own.select(slice(1, 3))
    assert part.survival.tolist() == own.survival[1:].tolist()
    assert part.driving_variance.tolist() == [[3, 4], [5, 6]]
    assert part._replace(survival=shared.survival, driving_variance=shared.driving_variance) == shared


def test_settings_are_stacked_one_after_another():
    one = parameters(F64)
    other = one._replace(survival=torch.tensor(0.3, dtype=F64), driving_variance=2 * one.driving_variance)
    both = stack_parameters([one, other], 3)
    for b in range(6):
        alone = both.select(slice(b, b + 1))
        for found, expected in zip(alone, one if b < 3 else other, strict=True):
            assert torch.equal(found, expected[None])


def test_a_count_left_to_the_data_stays_so_in_all_settings_or_in_none():
    one = parameters(F64)
    other = one._replace(effective_count=None)
    assert stack_parameters([other, other], 2).effective_count is None
    assert stack_parameters([other, other], 2).select(slice(0, 1)).effective_count is None
    with pytest.raises(InputError, match="'effective_count': found 1 of 2 settings with a value, expected"):
        stack_parameters([one, other], 2)


@pytest.mark.parametrize("name", ["power_shape", "noise_shape"])
def test_a_shape_that_no_belief_can_follow_is_named(name):
    tracker = make_tracker()
    parameters = tracker.parameters._replace(**{name: torch.tensor([2.0, 0.5])})
    with pytest.raises(InputError, match=f"key '{name}': found 0.5, expected a number of at least 1"):
        tracker.with_parameters(parameters)
