"""The start of a step."""

import torch
from oracles.line_array import make_region, make_tracker

from torchdt.filter.bp.beliefs import Beliefs
from torchdt.filter.predict import exchangeable, predict
from torchdt.model.motion.driving import Score
from torchdt.model.prior import Priors
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
REGION = make_region()


def predicted(
    bearings: list[float], deviation: float, log_odds: list[float], num_particles: int | None = None
):
    """Objects at given bearings with particles of one deviation, one step later."""
    tracker = make_tracker(particles=400, slots=len(bearings))
    limit = torch.full((2,), 4.0, dtype=F64)
    state = tracker.init(Priors(limit, limit))
    rng = torch.Generator().manual_seed(1)
    noise = torch.randn(len(bearings), 400, 2, generator=rng, dtype=F64) * torch.tensor([deviation, 0.01])
    centre = torch.tensor(bearings, dtype=F64)[:, None]
    noise[..., 0] = noise[..., 0] - noise[..., 0].mean(-1, keepdim=True) + centre
    objects = state.objects._replace(state=noise, log_odds=torch.tensor(log_odds, dtype=F64))
    draws = torch.zeros(len(bearings), 400, 1, dtype=F64)
    before = state._replace(objects=objects)
    return predict(
        tracker.field, tracker.region, tracker.model, 1.0, before, draws, Score(), 4, num_particles
    )


def test_objects_whose_predictions_overlap_may_change_places():
    """Two degrees apart: 2.8 deviations of the difference of 0.5 each, 4.7 of 0.3 each."""
    near = exchangeable(predicted([0.0, 2.0], 0.5, [3.0, 2.0]), REGION)
    assert near[0, 1]
    apart = exchangeable(predicted([0.0, 2.0], 0.3, [3.0, 2.0]), REGION)
    assert not apart[0, 1]


def test_an_object_that_does_not_exist_changes_places_with_none():
    pairs = exchangeable(predicted([0.0, 0.1, 0.2], 0.5, [3.0, 2.0, -torch.inf]), REGION)
    assert pairs.shape == (2, 2), "slots that are empty throughout are left out"
    assert pairs[0, 1]


def test_prediction_keeps_weights_and_lowers_existence():
    found = predicted([0.0, 20.0], 0.5, [3.0, 2.0])
    assert isinstance(found.beliefs, Beliefs)
    expected = 0.95 * torch.sigmoid(torch.tensor([3.0, 2.0], dtype=F64))
    torch.testing.assert_close(found.objects.existence, expected)
    mean, tril = found.density.mean[:, 0], found.density.tril[:, 0]
    covariance = tril @ tril.mT
    assert found.density.log_weight.shape == (2, 1), "of one mode each"
    torch.testing.assert_close(mean[:, 0], torch.tensor([0.0, 20.0], dtype=F64), atol=0.01, rtol=0)
    # Driving noise of variance 1e-3 over one second adds a quarter of that to the variance of the bearing.
    position, rate = (found.objects.state[..., i] for i in (0, 1))
    spread = position.var(-1, correction=0) + 0.25e-3
    torch.testing.assert_close(covariance[:, 0, 0], spread)
    torch.testing.assert_close(covariance[:, 1, 1], rate.var(-1, correction=0) + 1e-3)


def test_a_part_of_the_particles_is_enough_for_the_moments():
    """Every fourth of 400: phases across the array differ by 0.3 rad, so an element has an error of 0.03."""
    full, part = (predicted([0.0, 20.0], 0.5, [3.0, 2.0], num_particles) for num_particles in (None, 100))
    assert part.response.shape[-2] == 100
    torch.testing.assert_close(part.beliefs.moment, full.beliefs.moment, atol=0.15, rtol=0)
    torch.testing.assert_close(part.beliefs.objects, full.beliefs.objects)
    trace = part.beliefs.moment.diagonal(dim1=-2, dim2=-1).sum(-1)
    torch.testing.assert_close(trace, full.beliefs.moment.diagonal(dim1=-2, dim2=-1).sum(-1))
    assert predicted([0.0], 0.5, [3.0], 300).response.shape[-2] == 400, "fewer would not be enough"


def test_objects_on_both_sides_of_the_seam_may_change_places():
    """At -179.5 and 179.5 degrees: one degree apart where bearings go round, else nearly a turn."""
    both = predicted([-179.5, 179.5], 0.5, [3.0, 2.0])
    for period, near in ((360.0, True), (None, False)):
        region = Region([Coordinate("bearing", "deg", -180, 180, 5, -1, 1, 1e-3, period)], F64)
        assert bool(exchangeable(both, region)[0, 1]) is near
