"""Whole explanations of a step on the line array: objects, and signals that are none."""

import pytest
import torch
from oracles.interferers import ship
from oracles.line_array import make_tracker, simulate
from torch import Tensor

from torchdt.core.random import RandomStreams
from torchdt.core.trees import tree_map
from torchdt.filter.bp.update import free_energy, update
from torchdt.filter.context import StepContext
from torchdt.filter.direct import DirectTracker
from torchdt.filter.explain import Explainer, _alike
from torchdt.filter.history import TrackHistory
from torchdt.filter.interference.settings import NoInterference
from torchdt.filter.placement import Placer
from torchdt.filter.state import TrackerState
from torchdt.model.measurement import Measurement, from_snapshots
from torchdt.model.prior import Priors, data_priors

F64 = torch.float64
SEEDS, STEPS = [0, 1, 2, 3, 4, 5], 6
ONE = ((0.0, 5.0), (20.0, 12.0))
BEARING = torch.linspace(5.0, 7.1, STEPS)


def run(data: Tensor, seeds: list[int] = SEEDS, **config) -> TrackHistory:
    measurement = from_snapshots(data)
    streams = RandomStreams.from_seeds(seeds, (len(seeds),), F64)
    with torch.inference_mode():
        return make_tracker(**config).run(measurement, data_priors(measurement), streams)


def sources(*paths, steps: int = STEPS, seeds: list[int] = SEEDS) -> Tensor:
    return torch.stack([simulate(seed, *paths, steps=steps)[0] for seed in seeds])


def ships(power: float, seeds: list[int] = SEEDS) -> Tensor:
    return torch.stack([ship(seed, STEPS, power) for seed in seeds])


@pytest.mark.parametrize("power", [10.0, 100.0])
def test_a_source_beside_a_loud_signal_that_is_none(power):
    """19 and 29 dB louder, of another signature in each tone. Without a place for it the source is lost."""
    data = sources(ONE) + ships(power)
    history = run(data)
    assert history.declared[:, 1:].sum(-1).eq(1).all()
    position = history.position[:, 1:, :, 0][history.declared[:, 1:]].reshape(len(SEEDS), -1)
    assert ((position - BEARING[1:]).abs() < 4).all()
    history = run(data, interference=NoInterference())
    near = (history.position[..., 0] - BEARING[:, None]).abs() < 4
    assert not (near & history.declared)[:, 1:].any()


def test_the_loud_signal_alone_is_no_object():
    assert not run(sources() + ships(100.0)).declared.any()


@pytest.mark.parametrize("gap", [60.0, 20.0, 8.0])
def test_two_sources_that_arrive_together_are_found(gap):
    """At once, though each alone would leave the other for a signal of free signature."""
    both = [((0.0, side * gap / 2), (20.0, side * gap / 2)) for side in (-1, 1)]
    history = run(torch.cat([sources(steps=3), sources(*both, steps=3)], 1))
    assert history.declared.sum(-1).tolist() == [[0, 0, 0, 2, 2, 2]] * len(SEEDS)


def test_a_sequence_is_in_a_batch_what_it_is_alone():
    """A ship in one of three, and one that has nothing but noise."""
    seeds = [0, 1, 2]
    data = torch.stack([*sources(ONE, seeds=[0, 1]), *sources(seeds=[2])])
    data[1] += ship(1, STEPS, 10.0)
    together = run(data, seeds)
    assert together.declared[:, -1].sum(-1).tolist() == [1, 1, 0]
    for b, seed in enumerate(seeds):
        alone = run(data[b : b + 1], [seed])
        for name in ("existence", "declared", "noise", "log_evidence"):
            found, expected = getattr(together, name)[b], getattr(alone, name)[0]
            torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6)


def started(**config) -> tuple[DirectTracker, TrackerState, Measurement, Priors, RandomStreams]:
    """A tracker after three steps of a source and a ship, and the data of the fourth."""
    measurement = from_snapshots(sources(ONE, seeds=[1]) + ships(10.0, [1]))
    tracker, priors = make_tracker(**config), data_priors(measurement)
    state, streams = tracker.init(priors), RandomStreams.from_seeds([1], (1,), F64)
    with torch.inference_mode():
        for k in range(3):
            state, _ = tracker.step(state, measurement.at(k), priors, streams)
    return tracker, state, measurement.at(3), priors, streams


def test_without_data_interferers_go_on():
    tracker, state, data, priors, streams = started()
    assert state.interference.ne(0).any()
    with torch.inference_mode():
        after, estimate = tracker.step(state, data.silent(), priors, streams)
        assert torch.equal(after.interference, state.interference)
        assert estimate.log_evidence.item() == 0
        assert estimate.declared.sum() == 1
        _, estimate = tracker.step(after, data, priors, streams)
    assert estimate.declared.sum() == 1


def explainer(tracker, state, data, priors, streams) -> Explainer:
    context = StepContext(tracker.field, tracker.region, tracker.model, tracker.model.noise, data)
    draws = tracker.draw(streams)
    predicted, places = tracker.predict(state, draws.driving), (draws.known, draws.newborn, draws.picks)
    return Explainer(
        context, tracker.dictionary, tracker.config, predicted, state.interference, priors, places
    )


def test_where_there_is_no_place_for_them_it_is_placing_and_messages_alone():
    found = explainer(*started(interference=NoInterference()))
    placed, residual = Placer(found.context, found.dictionary, found.config).place(
        found.predicted, found.priors, *found.draws
    )
    beliefs = update(
        placed.objects,
        placed.response,
        found.predicted.beliefs.noise,
        found.context.measurement,
        sweeps=found.config.sweeps,
        initial=placed.beliefs,
    )
    explanation = found.explain()
    assert explanation.beliefs.interferers is None
    torch.testing.assert_close(explanation.beliefs, beliefs, rtol=0, atol=0)
    torch.testing.assert_close(explanation.residual, residual, rtol=0, atol=0)


def test_empty_slots_leave_an_explanation_as_it_is():
    found = explainer(*started())
    explanation = found.explain()
    number = explanation.placed.objects.log_odds.shape[-1]
    objects = tree_map(lambda t: torch.cat([t, t[:, -1:]], 1), explanation.placed.objects)
    longer = explanation._replace(placed=explanation.placed._replace(objects=objects))
    same, padded = _alike(longer, explanation)
    assert same is longer
    assert padded.placed.objects.log_odds.shape[-1] == number + 1
    assert padded.beliefs.objects.log_odds[0, number].isneginf()
    values = [
        free_energy(e.beliefs, e.placed.objects, found.context.measurement, found.context.noise)
        for e in (explanation, padded)
    ]
    torch.testing.assert_close(*values)


def test_a_step_without_data_among_loud_ones_breaks_nothing():
    """100 dB from one step to the next, in single precision, and an object that is as loud: what numbers can
    tell from rounding depends on all that is there."""
    data = sources(ONE) + ships(1.0)
    data[:, 2:] *= 1e5
    data[:, 3] = torch.nan
    measurement = from_snapshots(data.to(torch.complex64))
    streams = RandomStreams.from_seeds(SEEDS, (len(SEEDS),), torch.float32)
    with torch.inference_mode():
        history = make_tracker(torch.float32).run(measurement, data_priors(measurement), streams)
    assert not history.failed.any()
    assert history.existence.isfinite().all()


def test_what_interferers_cost_is_taken_off_the_evidence():
    tracker, state, data, priors, streams = started()
    found = explainer(tracker, state, data, priors, streams)
    placed, _, beliefs = found.explain()
    cost = beliefs.interferers.cost
    assert cost.sum() > 1
    free = beliefs._replace(interferers=beliefs.interferers._replace(cost=0 * cost))
    draws = tracker.draw(streams).evidence
    paid, unpaid = (
        tracker.evidence(found.context, found.predicted, placed, b, draws) for b in (beliefs, free)
    )
    torch.testing.assert_close(unpaid - paid, cost.sum(-1))
