import numpy as np
import pytest

from torchdt.field import Environment, HalfSpace, Layer, combine_eofs

HALF = HalfSpace(1800.0, 2.0, 0.1)
LAYER = Layer(120.0, 1550.0, 1600.0, 1.5, 0.2)
PROFILE = [[0, 1500], [50, 1490], [100, 1480]]


def speed_at(environment, depth):
    return np.interp(depth, *np.array(environment.profile).T)


def test_lists_become_a_hashable_environment():
    environment = Environment(PROFILE, [LAYER], HALF)
    assert environment.profile == ((0.0, 1500.0), (50.0, 1490.0), (100.0, 1480.0))
    assert hash(environment) == hash(Environment(tuple(PROFILE), (LAYER,), HALF))
    assert environment.water_depth == 100.0


@pytest.mark.parametrize("depth", [80.0, 50.0, 130.0])
def test_water_depth_moves_everything_below(depth):
    changed = Environment(PROFILE, [LAYER], HALF).perturbed(water_depth=depth)
    assert changed.water_depth == depth
    assert changed.layers[0].bottom == pytest.approx(depth + 20.0)
    assert changed.layers[0].speed_top == LAYER.speed_top
    for z in np.linspace(0, depth, 27):
        assert speed_at(changed, z) == pytest.approx(np.interp(z, [0, 50, 100], [1500, 1490, 1480]))


def test_speed_change_keeps_its_own_knots():
    original = Environment(PROFILE, [LAYER], HALF)
    delta = combine_eofs([0, 10, 60], [[1, 0], [2, 1], [-1, 3]], [0.5, 2.0])
    changed = original.perturbed(delta_c=delta)
    for z in np.linspace(0, 100, 41):
        expected = np.interp(z, [0, 10, 60], [0.5, 3.0, 5.5])  # constant below 60 m
        assert speed_at(changed, z) - speed_at(original, z) == pytest.approx(expected)


def test_no_change_is_the_same_environment():
    environment = Environment(PROFILE, [LAYER], HALF)
    assert environment.perturbed() == environment
    assert hash(environment.perturbed(delta_c=[[0, 0.0]])) == hash(environment)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Environment([[1, 1500], [2, 1500]], [], HALF), "at depth 0"),
        (lambda: Environment([[0, 1500]], [], HALF), "two or more"),
        (lambda: Environment([[0, 1500], [0, 1490]], [], HALF), "profile.*increasing"),
        (lambda: Environment([[0, 1500], [9, -1]], [], HALF), "speed in profile is -1"),
        (lambda: Environment([[0, 1500], [9, float("nan")]], [], HALF), "finite"),
        (lambda: Environment([[0, 1500], [150, 1490]], [LAYER], HALF), "layers.*120"),
        (lambda: HalfSpace(0.0, 1.0, 0.0), "speed is 0"),
        (lambda: HalfSpace(1800.0, 1.0, -0.1), "attenuation is -0.1"),
        (lambda: Layer(120.0, 1500.0, 1500.0, 0.0, 0.0), "density is 0"),
        (lambda: Environment(PROFILE, [], HALF).perturbed(water_depth=-1), "water_depth is -1"),
        (lambda: Environment(PROFILE, [], HALF).perturbed(delta_c=[[5, 1], [2, 1]]), "delta_c.*increasing"),
        (lambda: combine_eofs([0, 10], [[1.0], [2.0]], [1.0, 2.0]), "eofs has shape"),
    ],
)
def test_wrong_input_is_named(build, message):
    with pytest.raises(ValueError, match=message):
        build()
