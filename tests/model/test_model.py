import dataclasses
import math

import numpy as np
import pytest
import torch
from oracles.line_array import make_region, make_tracker

from torchdt.core.errors import InputError
from torchdt.core.support import REAL, UNIT, Quantity
from torchdt.model.birth import UniformBirth
from torchdt.model.hyperparameters import Hyperparameters, HyperparameterSettings
from torchdt.model.model import Model, stack_models
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.part import append_dims, number
from torchdt.model.power.gamma import GammaPower
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


def model(dtype: torch.dtype) -> Model:
    return Model().with_numbers({name: torch.tensor(value, dtype=dtype) for name, value in VALUES.items()})


def same(one: Model, other: Model) -> bool:
    a, b = one.known(), other.known()
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_numbers_are_those_of_the_parts_and_of_the_region(dtype):
    found = Model(power=GammaPower(50.0), survival=0.9, likelihood_power=0.5).on(Region(TWO, dtype))
    assert {value.dtype for value in found.known().values()} == {dtype}
    assert found.effective_count is None
    expected = {"power_shape": 50.0, "noise_shape": 100.0, "survival": 0.9, "birth_mean": 1e-4}
    expected |= {"driving_variance": [1e-2, 1e-4], "likelihood_power": 0.5}
    assert set(found.known()) == set(expected)
    for name, value in found.known().items():
        torch.testing.assert_close(value, torch.tensor(expected[name], dtype=dtype), rtol=0, atol=0)


def test_the_driving_variance_of_the_motion_comes_first():
    found = Model(motion=ConstantVelocity([3.0, 4.0])).on(Region(TWO))
    assert found.motion.driving_variance.tolist() == [3.0, 4.0]


@pytest.mark.parametrize("driving", [[1e-3, 1e-3], [1e-3, 1e-3, 1e-3]])
def test_another_number_of_driving_variances_is_named(driving):
    key = "model.motion.driving_variance"
    expected = rf"'{key}': found \[0.001.*\], expected one number for each of 1 coordinates"
    with pytest.raises(InputError, match=expected):
        Model(motion=ConstantVelocity(driving)).on(make_region())


def test_a_number_has_one_owner():
    @dataclasses.dataclass(frozen=True)
    class Second(UniformBirth):
        survival: float = number(0.5, UNIT)

    with pytest.raises(InputError, match="'survival': found a number of both model and birth"):
        Model(birth=Second())


def test_a_configuration_nests_the_numbers_under_their_parts():
    found = Model().as_config({"survival": 0.9, "power_shape": 20.0, "birth_mean": 0.1, "tilt_deg": 1.0})
    assert found == {"survival": 0.9, "power": {"power_shape": 20.0}, "birth": {"birth_mean": 0.1}}


@pytest.mark.parametrize(("batch", "dims"), [((), 0), ((), 1), ((), 2), ((3,), 1), ((2, 3), 2)])
def test_widened_values_broadcast_over_what_follows_the_batch(batch, dims):
    value = torch.randn(batch, generator=torch.Generator().manual_seed(1))
    wide = append_dims(value, dims)
    assert wide.shape == (*batch, *[1] * dims)
    following = torch.zeros((*batch, *[4] * dims))
    for at in np.ndindex(*batch):
        assert (wide + following)[at].eq(value[at]).all()


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_values_enter_with_their_gradient(dtype):
    old = model(dtype)
    quantities = old.all_quantities() | {"tilt_deg": Quantity(REAL, 0.5)}
    module = Hyperparameters({name: HyperparameterSettings() for name in quantities}, quantities)
    with torch.no_grad():
        for raw in module.parameters():
            raw.add_(0.5)
    values = module()
    assert "tilt_deg" in values
    new = old.with_numbers({name: value for name, value in values.items() if name != "tilt_deg"})
    for name, value in new.known().items():
        assert value.dtype == dtype
        torch.testing.assert_close(value, values[name].to(dtype))
    (found,) = torch.autograd.grad(
        new.motion.driving_variance.sum(), [module.get_parameter("driving_variance")]
    )
    torch.testing.assert_close(found, values["driving_variance"].detach(), rtol=1e-6, atol=0)


def test_numbers_that_are_not_named_stay():
    old = model(F64)
    per_sequence = torch.tensor([0.5, 0.6, 0.7])
    new = old.with_numbers({"survival": per_sequence})
    torch.testing.assert_close(new.survival, per_sequence.double())
    assert same(new.with_numbers({"survival": old.survival}), old)
    with pytest.raises(InputError, match="'speed': found an unknown number, expected one of"):
        old.with_numbers({"speed": 1.0})


def test_some_sequences_have_their_numbers():
    shared = model(F64)
    assert same(shared.select(slice(1, 2)), shared)
    driving = torch.tensor([[1.0, 2], [3, 4], [5, 6]])
    own = shared.with_numbers({"survival": torch.tensor([0.5, 0.6, 0.7]), "driving_variance": driving})
    part = own.select(slice(1, 3))
    assert part.survival.tolist() == own.survival[1:].tolist()
    assert part.motion.driving_variance.tolist() == [[3, 4], [5, 6]]
    back = {"survival": shared.survival, "driving_variance": shared.motion.driving_variance}
    assert same(part.with_numbers(back), shared)


def test_settings_are_stacked_one_after_another():
    one = model(F64)
    other = one.with_numbers({"survival": 0.3, "driving_variance": 2 * one.motion.driving_variance})
    both = stack_models([one, other], 3)
    for b in range(6):
        alone = both.select(slice(b, b + 1)).known()
        for name, expected in (one if b < 3 else other).known().items():
            assert torch.equal(alone[name], expected[None])


def test_a_count_left_to_the_data_stays_so_in_all_settings_or_in_none():
    one = model(F64)
    other = one.with_numbers({"effective_count": None})
    assert stack_models([other, other], 2).effective_count is None
    assert stack_models([other, other], 2).select(slice(0, 1)).effective_count is None
    with pytest.raises(InputError, match="'effective_count': found 1 of 2 settings with a value, expected"):
        stack_models([one, other], 2)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        *(
            (f"model.{part}.{part}_shape", bad, "a finite number of at least 1")
            for part in ("power", "noise")
            for bad in (0.0, 0.99, math.inf)
        ),
        *(("model.birth.birth_mean", bad, "a positive number") for bad in (0.0, math.inf, True, "many")),
        *(("model.survival", bad, "a probability strictly between 0 and 1") for bad in (0.0, 1.0, None)),
        *(("model.likelihood_power", bad, "a number above 0, up to 1") for bad in (0.0, 1.1)),
        ("model.motion.driving_variance", 1.0, "a list, each entry a positive number"),
        ("model.effective_count", -1.0, "a positive number"),
    ],
)
def test_a_number_out_of_range_is_named(key, value, expected):
    with pytest.raises(InputError, match=f"key '{key}': found {value}, expected {expected}"):
        Model().with_numbers({key.rpartition(".")[2]: value})


@pytest.mark.parametrize("name", ["power_shape", "noise_shape"])
def test_a_shape_that_no_belief_can_follow_is_named(name):
    expected = f"key 'model.{name.split('_')[0]}.{name}': found 0.5, expected a finite number of at least 1"
    with pytest.raises(InputError, match=expected):
        make_tracker().model.with_numbers({name: torch.tensor([2.0, 0.5])})
