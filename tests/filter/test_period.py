"""Bearings that go round: a track across the seam is that of the same data far from it."""

import pytest
import torch
from torch import Tensor

from torchdt.baselines.detect.config import PursuitConfig, SblConfig
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.random import RandomStreams
from torchdt.field import PlaneWaveField
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.history import TrackHistory
from torchdt.filter.proposal.adapted import Adapted
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.filter.tracker import Tracker
from torchdt.model.measurement import from_snapshots
from torchdt.model.prior import Priors
from torchdt.model.region import Coordinate, Region

F64 = torch.float64
PLACES = torch.tensor(
    [[0.0, 0, 0], [4, 0, 0], [0, 5, 0], [4, 6, 0], [9, 2, 0], [8, 8, 0], [1, 9, 0]], dtype=F64
)
TWO_STEP = {"slots": 3, "particles": 100, "birth_mean": 0.3, "clutter_mean": 0.3, "survival": 0.99}
TRACKERS = {
    "adapted": TrackerConfig(slots=3, particles=60, births=2, proposal=Adapted(rounds=3, round_size=40)),
    "prior": TrackerConfig(slots=3, particles=400, births=2, proposal=AsPredicted()),
    "pursuit": TwoStepConfig(**TWO_STEP, detector=PursuitConfig(points=3)),
    "sbl": TwoStepConfig(**TWO_STEP, detector=SblConfig(points=3, sources=2, max_iterations=20)),
}


def field(places: Tensor) -> PlaneWaveField:
    return PlaneWaveField([90.0, 140.0], places.tolist(), 1500.0, "bearing", dtype=F64)


def make_tracker(kind: str, places: Tensor, period: float | None) -> Tracker:
    region = Region([Coordinate("bearing", "deg", -180, 180, 5, -2, 2, 1e-2, period)], F64)
    config = TRACKERS[kind]
    if isinstance(config, TwoStepConfig):
        return TwoStepTracker(field(places), region, 1.0, config)
    return DirectTracker(field(places), region, 1.0, config)


def snapshots() -> Tensor:
    """Two sources that meet near north, one of them across it; `(1, K, I, J, M)`."""
    rng = torch.Generator().manual_seed(4)
    steps = torch.arange(7.0, dtype=F64)
    bearing = torch.stack([-6.2 + 1.3 * steps, 31.0 - 1.5 * steps], -1)
    amplitude = torch.randn(7, 2, 2, 3, generator=rng, dtype=torch.complex128)
    signal = torch.einsum("knij,knim->kijm", amplitude, field(PLACES)(bearing[..., None]))
    return (signal + 0.05 * torch.randn(signal.shape, generator=rng, dtype=torch.complex128))[None]


def run(tracker: Tracker, z: Tensor) -> TrackHistory:
    measurement = from_snapshots(z)
    limit = torch.full((1, 2), 4.0, dtype=F64)
    streams = RandomStreams.from_seeds([1], (1,), F64)
    state, steps = tracker.init(Priors(limit, limit)), []
    for k in range(z.shape[1]):
        state, estimate = tracker.step(state, measurement.at(k), Priors(limit, limit), streams)
        steps.append(estimate)
    return TrackHistory.of_steps(steps, 1)


@pytest.mark.parametrize("kind", TRACKERS)
def test_a_track_across_the_seam_is_that_of_the_turned_array(kind):
    """An array turned by 180 degrees hears the same from the other side, where the bearing has its seam."""
    z = snapshots()
    straight = run(make_tracker(kind, PLACES, None), z)
    turned = run(make_tracker(kind, -PLACES, 360.0), z)
    assert torch.equal(turned.declared, straight.declared)
    assert torch.equal(turned.label, straight.label)
    found, expected = (history.state[history.declared] for history in (turned, straight))
    assert found[:, 0].abs().amin() > 140
    assert set(found[:, 0].sign().tolist()) == {1.0, -1.0}
    expected = expected + torch.tensor([180.0, 0.0], dtype=F64)
    expected[:, 0] = torch.remainder(expected[:, 0] + 180, 360) - 180
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
    parts = [
        [getattr(h, name)[h.declared] for h in (turned, straight)] for name in ("state_std", "existence")
    ]
    for one, other in parts:
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-6)
    if not straight.log_evidence.isnan().any():
        torch.testing.assert_close(turned.log_evidence, straight.log_evidence, rtol=0, atol=1e-6)
