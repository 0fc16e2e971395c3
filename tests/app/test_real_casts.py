"""The default tracker in water that was really there, with an array and a seafloor off nominal."""

import copy

import numpy as np
import pytest
import torch

from torchdt.app.build import build_tracker
from torchdt.app.targets import build_field
from torchdt.app.track import score_history
from torchdt.data.recording import validate
from torchdt.field.build import EnvironmentDraw
from torchdt.run.track import generator, track
from torchdt.simulation.simulate import simulate_snapshots

pytestmark = pytest.mark.slow
CAST = 10  # of those that reach 160 m; its high tones do not resemble the nominal ones
DEPARTURE = EnvironmentDraw(tilt_deg=0.7, water_depth_m=-0.7)
SEED = 10
KEPT = ("bow_std_m", "slope_std_m_per_km", "gain_std_db", "phase_std_deg")


@pytest.fixture(scope="module")
def default(settings):
    # Bow, slope and sensors have tests of their own, and cost most of a fit.
    kept = [f"calibration.{name}=0" for name in KEPT]
    return settings("scenario.num_steps=40", "scenario.amplitudes=constant_modulus", *kept, small=False)


@pytest.fixture(scope="module")
def real_field(default, casts):
    """The nominal field, but for a measured profile, tilt and water depth; the bottom of both is the same."""
    nominal = np.array(default.field["profile"])
    depth, speed = casts[0][::4], casts[1][::4, CAST]
    deeper = nominal[nominal[:, 0] > depth[-1] + 2]
    deeper[:, 1] += speed[-1] - np.interp(depth[-1], *nominal.T)
    target = copy.deepcopy(default.field)
    target["profile"] = np.vstack([np.stack([depth, speed], -1), deeper]).tolist()
    return build_field(target, torch.float64, "cpu", draw=DEPARTURE)


@pytest.fixture(scope="module")
def recording(default, real_field):
    snapshots, truth = simulate_snapshots(real_field, default.scenario, generator(SEED, "simulation"))
    return validate(snapshots=snapshots[None], truth=truth[None], step_s=default.scenario.step_s)


def test_the_water_is_another_one(default, real_field, recording):
    """In the nominal environment the highest tone would find almost nothing where the sources are."""
    nominal = build_field(default.field, torch.float64, "cpu")
    position = recording.truth[0, ::10].flatten(0, 1)
    likeness = (real_field(position).conj() * nominal(position)).sum(-1).abs().square().mean(0)
    assert likeness[0] > 0.8
    assert likeness[-1] < 0.2


def test_tracks_in_real_water(default, recording):
    tracker = build_tracker(default, recording)
    history = track(recording, tracker, [SEED])
    score = score_history(history, recording, default)
    half = recording.num_steps // 2
    assert not score.false[:, half:].any()
    assert float(score.total.mean()) < 40
