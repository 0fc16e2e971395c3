"""On what tuning works and where it starts."""

from dataclasses import replace

import pytest
import torch
from hydra import compose, initialize_config_module
from oracles.scripts import SMALL

from torchdt.app.settings import settings_of
from torchdt.app.tunable import build_problem, gather
from torchdt.app.tune_settings import TuneSettings
from torchdt.data.npz import write_npz
from torchdt.model.hyperparameters import HyperparameterSettings

START = {
    "effective_count": 25.0,
    "mismatch_share": [0.02, 0.03],
    "eof_coefficients": [0.5, 0.0, 0.0, 0.0],
    "tilt_deg": 0.3,
    "water_depth_m": 1.2,
}


def settings(*overrides) -> TuneSettings:
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        return settings_of(compose("tune", overrides=[*SMALL, "scenario.num_steps=1", *overrides]))


@pytest.mark.slow
def test_it_starts_as_configured():
    """On covariances of a number of snapshots that they say, and in an environment other than the nominal."""
    chosen = settings(
        *("scenario=matched_20", "calibration=none", "field.freqs=[49,79]", "scenario.num_snapshots=40"),
        "+field.draw={eof_coefficients:[0.5],tilt_deg:0.3,water_depth_m:1.2}",
        "tracker.mismatch_share=[0.02,0.03]",
        "model.effective_count=25",
    )
    simulated = gather(chosen, [0], [], pad=False)
    z = simulated.recording.snapshots
    covariance = z.mT @ z.conj() / 40
    recording = replace(simulated.recording, snapshots=None, covariance=covariance, num_snapshots=40.0)
    sets = [simulated._replace(recording=recording)]
    wanted = {name: HyperparameterSettings() for name in START}
    found = build_problem(chosen, wanted, sets).hyperparameters.values()
    assert found == {name: pytest.approx(value) for name, value in START.items()}


def test_seeds_of_files_count_from_that_of_the_settings(tmp_path):
    chosen = settings("scenario=line_array", "seed=5")
    made = gather(chosen, [1, 2], [], pad=False)
    assert made.seeds == [1, 2]
    paths = [str(tmp_path / name) for name in ("two.npz", "again.npz")]
    for path in paths:
        write_npz(path, made.recording)
    read = gather(chosen, [], paths, pad=False)
    assert read.seeds == [5, 6, 7, 8]
    assert torch.equal(read.recording.snapshots[2:], made.recording.snapshots)
