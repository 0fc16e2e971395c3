"""From the intensity to potential objects, and back."""

import torch
from oracles.line_array import make_tracker

from torchdt.core.random import RandomStreams
from torchdt.filter.intensity.promote import candidate, give_back, promote

F64 = torch.float64


def intensity_at(tracker, cell: int, node: int, level: int, odds: float) -> torch.Tensor:
    """Most of it at one place, and a little everywhere."""
    intensity = tracker.undetected.init(torch.Size([1])) + 1e-9
    intensity[0, node, level, cell] = odds
    return intensity


def promoted(tracker, intensity, particles: int = 400):
    undetected = tracker.undetected
    near, odds = candidate(undetected, intensity)
    power, _ = powers(tracker)
    draws = RandomStreams.from_seeds([3], (1,), F64).normal(particles, 2)
    limit = torch.full((1, 2), 1e3, dtype=F64)
    one = promote(undetected, intensity, near, power, tracker.model.power, limit, 40, draws)
    return one, near, odds


def powers(tracker):
    """Powers of the tones' levels that are the levels themselves."""
    settings = tracker.undetected.settings
    around, share = settings.tone_levels(settings.level(torch.ones(1, dtype=F64)))
    return around.expand(1, 2, -1), share


def test_an_object_has_the_odds_place_and_powers_of_its_neighbourhood():
    tracker = make_tracker()
    cell, node, level = 30, len(tracker.undetected.grid.node) - 1, 2
    intensity = intensity_at(tracker, cell, node, level, 0.7)
    one, near, odds = promoted(tracker, intensity)
    torch.testing.assert_close(odds, (intensity.sum((1, 2)) * near).sum(-1))
    torch.testing.assert_close(one.log_odds.exp()[:, 0], odds)
    torch.testing.assert_close(one.log_weight.exp().sum(-1), torch.ones(1, 1, dtype=F64))
    torch.testing.assert_close(one.log_power_weight.exp().sum(-1), torch.ones(1, 1, 2, dtype=F64))
    state = one.state[0, 0]
    centre = tracker.undetected.dictionary.points[cell, 0]
    assert ((state[:, 0] - centre).abs() <= tracker.region.cell[0] / 2 + 1e-9).all()
    edge = tracker.undetected.grid.edge[0]
    assert ((state[:, 1] - tracker.undetected.grid.node[node, 0]).abs() <= edge / 2 + 1e-9).all()
    # The mean power of a level's tones is about that of the level, whatever stands for the silent ones.
    expected = tracker.undetected.grid.level[level]
    assert ((one.mean_power[0, 0] / expected).log().abs() < 0.5).all()


def test_the_neighbourhood_is_what_responses_do_not_tell_apart():
    tracker = make_tracker()
    intensity = intensity_at(tracker, 35, 0, 2, 0.7)
    _, near, _ = promoted(tracker, intensity)
    response = tracker.undetected.dictionary.response
    energy = response.abs().square().sum(-1)
    product = (response @ response[:, 35].conj()[..., None]).squeeze(-1).abs().square()
    alike = (product / energy / energy[:, 35:36]).mean(0)
    assert torch.equal(near[0], alike >= 0.5)
    assert 0 < near.sum() < near.numel()


def test_what_is_given_back_is_where_the_object_was():
    tracker = make_tracker()
    cell, node, level = 30, 0, 3
    one, _, odds = promoted(tracker, intensity_at(tracker, cell, node, level, 0.004))
    empty = tracker.undetected.init(torch.Size([1]))
    power, _ = powers(tracker)
    nothing = give_back(tracker.undetected, empty, one, torch.tensor([[False]]), power)
    assert nothing.eq(0).all()
    back = give_back(tracker.undetected, empty, one, torch.tensor([[True]]), power)
    torch.testing.assert_close(back.sum(), odds[0])
    torch.testing.assert_close(back[0, node].sum((0,))[cell], odds[0], rtol=1e-3, atol=0.0)
    assert int(back.sum((0, 1, 3)).argmax()) in (level - 1, level)
