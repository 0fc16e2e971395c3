"""Hypotheses about undetected objects and what one step makes of them, against closed forms of the motion."""

import math

import pytest
import torch

from torchdt.filter.intensity.settings import Intensity
from torchdt.filter.intensity.undetected import Undetected
from torchdt.filter.proposal.dictionary import Dictionary
from torchdt.model.birth import UniformBirth
from torchdt.model.birth_areas import AreaBirth
from torchdt.model.model import Model, stack_models
from torchdt.model.motion.constant_position import ConstantPosition
from torchdt.model.motion.constant_turn import ConstantTurn
from torchdt.model.motion.constant_velocity import ConstantVelocity
from torchdt.model.power.redrawn import RedrawnPower
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
ALL = [
    (ConstantVelocity(), 1),
    (ConstantVelocity(), 2),
    (ConstantVelocity(), 3),
    (ConstantTurn(), 2),
    (ConstantPosition(), 2),
]


def make_region(d: int, motion, cells: int = 24, variance: float = 1e-3, inside=None, **changed) -> Region:
    """Cells of two units."""
    each = {"low": -cells, "high": cells, "cell": 2, "rate_low": -1.5, "rate_high": 1.0} | changed
    coordinates = [Coordinate(name=name, unit="m", driving_variance=variance, **each) for name in "xyz"[:d]]
    return Region(coordinates, F64, inside=inside, motion=motion)


def make_undetected(region: Region, model: Model, step_s: float = 1.0, **settings) -> Undetected:
    points = region.cell_centres()
    nothing = torch.zeros(1, len(points), 1, dtype=torch.complex128)
    dictionary = Dictionary(points, nothing, nothing[..., 0].real)
    return Intensity(**settings).on(dictionary, region, model, step_s)


def make_model(region: Region, motion, **numbers) -> Model:
    """Without births worth a word."""
    model = Model(motion=motion).with_numbers({"birth_mean": 1e-30, "survival": 0.9} | numbers)
    return model.on(region)


@pytest.mark.parametrize(("motion", "d"), ALL)
def test_nodes_hold_all_new_objects_within_the_room_there_is(motion, d):
    region = make_region(d, motion, cells=8)
    for most in (region.num_cells * 5, region.num_cells * 5 * 20, 200_000):
        grid = make_undetected(region, make_model(region, motion), hypotheses=most).grid
        number = len(grid.node)
        assert number == math.prod(grid.axes) == len(grid.node_share)
        assert number * region.num_cells * len(grid.level) <= most
        assert grid.node_share.sum().item() == pytest.approx(1.0)
    extra = motion.num_extra(d)
    assert grid.node.shape == (number, extra)
    if extra:
        low, high = grid.node.amin(0) - grid.edge / 2, grid.node.amax(0) + grid.edge / 2
        torch.testing.assert_close(low[:d], torch.full((d,), -1.5, dtype=F64), rtol=0, atol=2e-3)
        torch.testing.assert_close(high[:d], torch.full((d,), 1.0, dtype=F64), rtol=0, atol=2e-3)
        mean = (grid.node_share[:, None] * grid.node).sum(0)
        torch.testing.assert_close(mean[:d], torch.full((d,), -0.25, dtype=F64), rtol=0, atol=2e-2)


def test_the_axis_that_takes_objects_apart_is_divided():
    region = Region(
        [
            Coordinate("x", "m", 0, 40, 2, -4, 4, 1e-3),
            Coordinate("y", "m", 0, 40, 2, -0.1, 0.1, 1e-3),
        ],
        F64,
    )
    axes = make_undetected(region, make_model(region, ConstantVelocity())).grid.axes
    assert axes == (16, 1)  # a quarter of a cell in a step each


@pytest.mark.parametrize("steps", [1, 4])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_an_object_of_constant_velocity_goes_on(d, steps):
    """Mass and mean, and the variance of one step: that of rates within a node and of the driving noise."""
    motion = ConstantVelocity()
    region = make_region(d, motion, cells=12 if d == 3 else 24)
    model = make_model(region, motion)
    undetected = make_undetected(region, model, hypotheses=100_000)
    centres, grid = region.cell_centres(), undetected.grid
    start = int(region.cell_of(torch.full((d,), 0.5, dtype=F64)))
    for node in (0, len(grid.node) - 1):
        intensity = undetected.init(torch.Size())
        intensity[node, 2, start] = 3.0
        # Along the edge of the rates some of the driving noise is cut off.
        quiet = model.with_numbers({"driving_variance": [1e-9] * d})
        for _ in range(steps):
            intensity = undetected.predict(intensity, quiet)
        mass, cells = intensity.sum(), intensity.sum((0, 1))
        assert mass.item() == pytest.approx(3 * 0.9**steps)
        mean = (cells[:, None] * centres).sum(0) / mass
        torch.testing.assert_close(mean, centres[start] + steps * grid.node[node], rtol=0, atol=1e-4)
        if steps == 1:
            variance = (cells[:, None] * (centres - mean).square()).sum(0) / mass
            share = (grid.node[node] / region.cell).frac().abs()
            least = region.cell.square() * share * (1 - share)
            expected = torch.maximum(grid.edge.square() / 12, least)
            torch.testing.assert_close(variance, expected, rtol=1e-6, atol=1e-6)
            # The rates are those of the node, and the level its own with the Gamma chain's little change.
            assert intensity[node].sum() / mass > 0.999
            assert intensity[:, 2].sum() / mass > 0.999


def test_driving_noise_spreads_rates_and_positions():
    region = make_region(1, ConstantVelocity(), cells=60, variance=0.02)
    model = make_model(region, ConstantVelocity())
    undetected = make_undetected(region, model)
    centres, grid = region.cell_centres()[:, 0], undetected.grid
    node, intensity = len(grid.node) // 2, undetected.init(torch.Size())
    intensity[node, 0, 30] = 1.0
    intensity = undetected.predict(intensity, model)
    rates = intensity.sum((1, 2)) / intensity.sum()
    mean = (rates * grid.node[:, 0]).sum()
    assert mean.item() == pytest.approx(grid.node[node, 0].item())
    least = 0.02  # within what cells can have: the mean is that of a node
    assert (rates * (grid.node[:, 0] - mean).square()).sum().item() == pytest.approx(least)
    cells = intensity.sum((0, 1)) / intensity.sum()
    middle = (cells * centres).sum()
    share = abs(grid.node[node, 0].item()) / 2
    expected = max(grid.edge.item() ** 2 / 12 + 0.02 / 4, 4 * share * (1 - share))
    assert (cells * (centres - middle).square()).sum().item() == pytest.approx(expected)


def test_an_object_that_turns_goes_round():
    motion = ConstantTurn(turn_variance=1e-12, turn_spread=0.05)
    region = make_region(2, motion, cells=16, variance=1e-9, rate_low=-2.0, rate_high=2.0)
    model, centres = make_model(region, motion), region.cell_centres()
    undetected = make_undetected(region, model, levels=1)
    grid = undetected.grid
    assert grid.axes[0] > 3
    state = torch.tensor([1.0, 1.0, 1.0, -0.7, 0.06], dtype=F64)
    node = int((grid.node - state[2:]).square().sum(-1).argmin())
    cell = int(region.cell_of(state[:2]))
    intensity = undetected.init(torch.Size())
    intensity[node, 0, cell] = 1.0
    state = torch.cat([centres[cell], grid.node[node]])
    for _ in range(5):
        intensity = undetected.predict(intensity, model)
        state = motion.on(region).move(state, torch.zeros(3, dtype=F64), 1.0)
    mass, cells = intensity.sum(), intensity.sum((0, 1))
    assert mass.item() == pytest.approx(0.9**5)
    mean = (cells[:, None] * centres).sum(0) / mass
    assert (mean - state[:2]).norm() < 0.02 * (centres[cell] - state[:2]).norm()
    rate = (intensity.sum((1, 2))[:, None] * grid.node).sum(0) / mass
    torch.testing.assert_close(rate, state[2:], rtol=1e-4, atol=1e-6)


def test_an_object_without_rates_wanders():
    region = make_region(2, ConstantPosition(), cells=40)
    model = make_model(region, ConstantPosition(driving_variance=[1.5, 0.3]))
    undetected = make_undetected(region, model)
    intensity, centres = undetected.init(torch.Size()), region.cell_centres()
    start = int(region.cell_of(torch.zeros(2, dtype=F64)))
    assert intensity.shape[0] == 1
    intensity[0, 0, start] = 1.0
    for _ in range(6):
        intensity = undetected.predict(intensity, model)
    cells = intensity.sum((0, 1)) / intensity.sum()
    mean = (cells[:, None] * centres).sum(0)
    torch.testing.assert_close(mean, centres[start])
    variance = (cells[:, None] * (centres - mean).square()).sum(0)
    torch.testing.assert_close(variance, torch.tensor([9.0, 1.8], dtype=F64))


def test_objects_leave_at_an_end_and_go_round_where_there_is_none():
    lost = []
    for period in (None, 48.0):
        region = make_region(1, ConstantVelocity(), variance=1e-9, period=period)
        model = make_model(region, ConstantVelocity(), survival=1 - 1e-12)
        undetected = make_undetected(region, model)
        intensity = undetected.init(torch.Size())
        intensity[-1, 0, -1] = 1.0
        for _ in range(8):
            intensity = undetected.predict(intensity, model)
        lost.append(1 - intensity.sum().item())
        if period is not None:
            # From the last cell, 23 m, about 7 m on.
            cells = intensity.sum((0, 1))
            place = region.cell_centres()[:, 0]
            mean = (cells * torch.where(place < 0, place + 48, place)).sum() / cells.sum()
            assert mean.item() == pytest.approx(23 + 8 * undetected.grid.node[-1, 0].item(), abs=1e-6)
    assert lost[0] > 0.9
    assert abs(lost[1]) < 1e-9


@pytest.mark.parametrize("birth", [UniformBirth(), AreaBirth(areas=[{"low": [-10, 0], "high": [5, 9]}])])
@pytest.mark.parametrize("motion", [ConstantVelocity(), ConstantTurn(), ConstantPosition()])
def test_births_are_those_of_the_model(motion, birth):
    region = make_region(2, motion, cells=12)
    model = Model(motion=motion, birth=birth).with_numbers({"birth_mean": 0.02}).on(region)
    undetected = make_undetected(region, model, levels=3)
    born = undetected.predict(undetected.init(torch.Size()), model)
    assert born.sum().item() == pytest.approx(0.02)
    expected = model.birth.log_odds(region, region.cell_centres()).exp()
    torch.testing.assert_close(born.sum((0, 1)), expected)
    torch.testing.assert_close(born.sum((0, 2)), torch.full((3,), 0.02 / 3, dtype=F64))
    torch.testing.assert_close(born.sum((1, 2)), 0.02 * undetected.grid.node_share)


def test_nothing_is_where_no_object_can_be():
    region = make_region(2, ConstantVelocity(), inside=lambda state: state[..., 0] < state[..., 1])
    model = make_model(region, ConstantVelocity(), birth_mean=0.1)
    undetected = make_undetected(region, model, levels=2)
    intensity = undetected.init(torch.Size())
    for _ in range(3):
        intensity = undetected.predict(intensity, model)
    there = intensity.sum((0, 1)) > 0
    assert torch.equal(there, region.is_birth_cell)
    assert 0.1 < intensity.sum().item() < 0.1 * (1 + 0.9 + 0.81)


def test_powers_redrawn_forget_the_level():
    region = make_region(1, ConstantVelocity())
    model = Model(power=RedrawnPower()).with_numbers({"birth_mean": 1e-30}).on(region)
    undetected = make_undetected(region, model, levels=4)
    intensity = undetected.init(torch.Size())
    intensity[0, 3, 12] = 1.0
    levels = undetected.predict(intensity, model).sum((0, 2))
    torch.testing.assert_close(levels, levels[0].expand(4))


@pytest.mark.parametrize(("motion", "d"), ALL)
def test_sequences_with_numbers_of_their_own_are_as_alone(motion, d):
    region = make_region(d, motion, cells=6)
    first = make_model(region, motion, birth_mean=0.1)
    other = first.with_numbers({"survival": 0.5, "driving_variance": [0.3] * d, "power_shape": 2.0})
    together = stack_models([first, other], 1)
    undetected, rng = make_undetected(region, together, hypotheses=20_000), torch.Generator().manual_seed(0)
    intensity = undetected.init(torch.Size([2]))
    intensity = torch.rand(intensity.shape, generator=rng, dtype=F64) * undetected.grid.born
    found = undetected.predict(intensity, together)
    for b, model in enumerate((first, other)):
        torch.testing.assert_close(found[b], undetected.predict(intensity[b], model))
