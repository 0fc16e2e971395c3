"""Tracking in an environment fitted to the recording first."""

import re
from functools import partial
from unittest import mock

import numpy as np
import pytest
import torch

from torchdt.app import build, environment
from torchdt.app.build import build_recording, build_tracker
from torchdt.app.environment import calibrated_field
from torchdt.app.targets import build_field
from torchdt.calibration import environment as calibration
from torchdt.calibration.environment import Calibration
from torchdt.field.stacked import StackedField

pytestmark = pytest.mark.slow
TINY = (
    "scenario=mismatch",
    "field.freqs=[49,148,283]",
    "scenario.num_steps=6",
    "scenario.step_s=30",
    # Bow, slope and sensors have tests of their own, and cost most of a fit.
    "calibration.bow_std_m=0",
    "calibration.slope_std_m_per_km=0",
    "calibration.gain_std_db=0",
    "calibration.phase_std_deg=0",
    "scenario.sources.static.frozen_step=12",
    "scenario.coordinates.0.low=3000",
    "scenario.coordinates.0.high=4500",
    "scenario.coordinates.0.driving_variance=1e-4",
    "scenario.coordinates.1.low=20",
    "scenario.coordinates.1.high=100",
    "tracker.particles=200",
    "tracker.slots=6",
    "tracker.births=5",
    "tracker.proposal.rounds=4",
    "tracker.proposal.round_size=64",
    "scenario.mismatch.tilt_deg=[0.8,0.8]",
    "calibration.steps=4",
    "calibration.passes=1",
    # Scores tell fields apart: nothing else makes up for a wrong one.
    "tracker/interference=none",
    "tracker/marginals=of_messages",
)
MATCHED = (
    "scenario.mismatch.eof_scale=0",
    "scenario.mismatch.tilt_deg=[0,0]",
    "scenario.mismatch.water_depth_m=[0,0]",
    "field.eofs=null",
)


@pytest.fixture(scope="module", autouse=True)
def roughly():
    """Fits that end early are good enough to track with."""
    with mock.patch.object(calibration, "focalise", partial(calibration.focalise, iterations=15)):
        yield


@pytest.fixture(scope="module")
def fitted():
    """Recordings and the fields fitted to them, in the order of the runs."""
    return []


@pytest.fixture(scope="module")
def calibrated(launch, fitted):
    """Two runs, of seeds 1 and 2, in one batch."""

    def calibrate(settings, recording, *of):
        fitted.append((recording, calibrated_field(settings, recording, *of)))
        return fitted[-1][1]

    with mock.patch.object(build, "calibrated_field", calibrate):
        return launch(*TINY, "runs=2", "seed=1", small=False)


def found(log: str, run: int) -> dict[str, float]:
    """Environment of a run as it was logged."""
    line = re.search(rf"sequence {run}: environment departs from nominal by (.*)", log)[1]
    return {name: float(value) for name, value in (part.rsplit(" ", 1) for part in line.split(", "))}


def test_better_than_the_nominal_environment_and_says_what_it_found(launch, calibrated):
    assert calibrated.status == 0, calibrated.err
    nominal = launch(*TINY, "runs=2", "seed=1", "calibration=none", small=False)
    assert nominal.status == 0, nominal.err
    scores = [np.reshape(outcome.scores, (2, 6)).mean(1) for outcome in (calibrated, nominal)]
    assert (scores[0] < 0.5 * scores[1]).all()
    assert "environment departs" not in nominal.log
    names = {"EOF 1", "EOF 2", "EOF 3", "EOF 4", "tilt (deg)", "water depth (m)"}
    for run in range(2):
        assert set(found(calibrated.log, run)) == names
        assert f"sequence {run}: unexplained share of each tone [" in calibrated.log
    assert calibrated.log.count("environment fit gains") >= 2


def test_finds_the_tilt_of_the_simulation(calibrated):
    """Its magnitude is set, its sign random."""
    for run in range(2):
        assert abs(found(calibrated.log, run)["tilt (deg)"]) == pytest.approx(0.8, abs=0.1)


def test_a_batch_equals_single_runs(launch, calibrated):
    """Each sequence has the field that fits it."""
    assert found(calibrated.log, 0) != found(calibrated.log, 1)
    alone = launch(*TINY, "seed=2", small=False)
    assert found(alone.log, 0) == found(calibrated.log, 1)
    np.testing.assert_allclose(calibrated.scores[6:], alone.scores, atol=0.1)


def test_fields_of_a_batch_are_those_of_the_runs(calibrated, fitted):
    """The field of a sequence explains this sequence and not the other."""
    ((recording, field),) = fitted
    assert isinstance(field, StackedField)
    assert len(field.fields) == 2
    share = torch.empty(2, 2)
    for b, f in np.ndindex(2, 2):
        response = field.fields[f](recording.truth[b].float()).to(torch.complex128).permute(0, 2, 3, 1)
        data = recording.snapshots[b].mT  # (K, I, M, J)
        left = data - response @ torch.linalg.lstsq(response, data).solution
        share[b, f] = left.abs().square().sum() / data.abs().square().sum()
    assert (share.diagonal() < 0.06).all(), share
    assert (share.flip(0).diagonal() > 0.1).all(), share


def test_a_nominal_environment_is_the_field_of_the_configuration(settings, caplog, monkeypatch):
    nothing = Calibration(torch.zeros(6, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    monkeypatch.setattr(environment, "calibrate", lambda *_: nothing)
    chosen = settings(*TINY, "scenario.num_steps=1", small=False)
    with caplog.at_level("INFO"):
        field = build_tracker(chosen, build_recording(chosen)).field
    assert "environment departs from nominal by nothing" in caplog.text
    nominal = build_field(chosen.field, torch.float32, "cpu")
    state = torch.tensor([[[3210.0, 57.0], [4321.0, 91.0]]])
    # Knots of the EOFs are added to the profile; they lie on it.
    torch.testing.assert_close(field(state), nominal(state), rtol=0.0, atol=1e-4)


def test_a_field_without_environment_is_refused(launch):
    outcome = launch("calibration=environment")
    assert outcome.status == 1
    expected = "key 'calibration.enabled': found True, expected false: this field has no environment to fit"
    assert expected in outcome.err


def test_a_waveguide_without_eofs_is_refused(launch):
    outcome = launch(*TINY, *MATCHED, small=False)
    assert outcome.status == 1
    assert "key 'calibration.enabled': found True, expected false (calibration=none), or" in outcome.err
    assert "EOFs in field.eofs" in outcome.err


def test_settings_out_of_range_are_named(launch):
    outcome = launch("+calibration.speed=0")
    assert outcome.status == 1
    assert "'speed'" in outcome.err or "calibration.speed" in outcome.err
