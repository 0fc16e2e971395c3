"""A random walk: exact moments, and trackers whose states have no rates."""

import csv

import pytest
import torch
from oracles.line_array import BEARING, SMALL, make_field, make_region, simulate
from oracles.scripts import call, load

from torchdt.app.report.belief import belief_of
from torchdt.app.report.clouds import Frame, cloud_figure
from torchdt.app.report.figures import Axis
from torchdt.baselines.two_step import TwoStepConfig, TwoStepTracker
from torchdt.core.random import RandomStreams
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.filter.proposal.as_predicted import AsPredicted
from torchdt.model.measurement import from_snapshots
from torchdt.model.model import Model
from torchdt.model.motion.base import BaseMotion, Motion
from torchdt.model.motion.constant_position import ConstantPosition
from torchdt.model.prior import data_priors

F64 = torch.float64


def test_moments_are_those_of_a_random_walk():
    rng = torch.Generator().manual_seed(1)
    mean, root = torch.randn(3, 4, 2, generator=rng, dtype=F64), torch.randn(2, 2, generator=rng, dtype=F64)
    covariance = (root @ root.mT).expand(3, 4, 2, 2)
    motion = ConstantPosition(torch.tensor([0.3, 2.0], dtype=F64))
    found = motion.moments(mean, covariance, 1.5)
    torch.testing.assert_close(found[0], mean)
    expected = covariance + 1.5**2 * torch.diag(torch.tensor([0.3, 2.0], dtype=F64))
    torch.testing.assert_close(found[1], expected)
    # The unscented transform of the base class is exact, since the motion is linear.
    unscented = BaseMotion.moments(motion, mean, covariance, 1.5)
    torch.testing.assert_close(unscented[0], mean)
    torch.testing.assert_close(unscented[1], expected)


def test_without_a_variance_steps_are_as_wide_as_the_rates_say():
    region = make_region()  # rates between -1 and 1, of mean square a third
    motion = ConstantPosition().on(region)
    torch.testing.assert_close(motion.driving_variance, torch.tensor([1 / 3], dtype=F64))
    assert isinstance(motion, Motion)
    assert motion.column_names(region.coordinates) == ("bearing_deg",)


@pytest.fixture(scope="module")
def data():
    snapshots, truth = simulate(1, ((0.0, 5.0), (20.0, 12.0)), steps=8, snr_db=15.0)
    return from_snapshots(snapshots[None]), truth


def tracker_of(kind: str) -> DirectTracker | TwoStepTracker:
    if kind == "two steps":
        config = TwoStepConfig(slots=4, particles=200)
        return TwoStepTracker(make_field(), make_region(), 1.0, config, ConstantPosition())
    config = TrackerConfig(**(SMALL | ({"proposal": AsPredicted()} if kind == "as predicted" else {})))
    return DirectTracker(make_field(), make_region(), 1.0, config, Model(motion=ConstantPosition()))


@pytest.mark.parametrize("kind", ["adapted", "as predicted", "two steps"])
def test_every_tracker_follows_an_object_without_rates(data, kind):
    measurement, truth = data
    tracker, last = tracker_of(kind), []
    streams = RandomStreams.from_seeds([3], (1,), F64)
    with torch.inference_mode():
        history = tracker.run(
            measurement, data_priors(measurement), streams, lambda *step: last.append(step[1:])
        )
    assert history.state.shape[-1] == history.position.shape[-1] == 1
    found = history.position[0, -1, :, 0][history.declared[0, -1]]
    assert (found - truth[-1, 0, 0]).abs().min() < 1.5
    state, estimate = last[-1]
    one = type(state)(*(_first(part) for part in state))
    frame = Frame.of_region(tracker.region, [Axis("Bearing (deg)")])
    panel = cloud_figure(belief_of(one, estimate.select(0)), estimate.select(0), truth[-1], 8.0, frame).axes[
        0
    ]
    assert panel.get_ylabel() == "Weight"
    assert panel.get_xlim() == (BEARING["low"], BEARING["high"])
    assert panel.get_ylim() == (0, 1)


def _first(tree):
    return tree[0] if isinstance(tree, torch.Tensor) else type(tree)(*map(_first, tree))


@pytest.mark.parametrize("tracker", ["direct", "mp_bp"])
def test_tables_have_positions_alone(tmp_path, tracker):
    options = ["scenario=line_array", "scenario.num_steps=4", "model/motion=constant_position"]
    options += [f"tracker={tracker}", "tracker.particles=100", "tracker.slots=4"]
    status, _, err = call(load("track"), *options, f"hydra.run.dir={tmp_path}")
    assert status == 0, err
    with open(tmp_path / "tracks.csv") as file:
        names = csv.DictReader(file).fieldnames
    assert "bearing_deg" in names
    assert not [name for name in names if "rate" in name]
