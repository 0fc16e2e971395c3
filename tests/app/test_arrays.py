"""Plane and spherical waves on arrays of any shape, from the command line to the tables."""

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from torchdt.app.build import build_recording, build_tracker
from torchdt.app.targets import build_field
from torchdt.data.npz import write_npz

pytestmark = pytest.mark.slow
SIZE = (
    "scenario.num_steps=12",
    "tracker.slots=4",
    "tracker.births=4",
    "tracker.particles=200",
    "tracker.proposal.round_size=64",
)
# The cutoffs, what missing one object in every step costs half of, are 0.2, 0.5 m and 30 degrees.
SCENARIOS = {"planar_array": 0.04, "near_field": 0.1, "all_round": 5.0}


@pytest.fixture(scope="module")
def runs(launch):
    """All scenarios, seeds 0 and 1."""
    return {name: launch(f"scenario={name}", "runs=2", *SIZE, small=False) for name in SCENARIOS}


@pytest.mark.parametrize("name", SCENARIOS)
def test_two_objects_are_tracked(runs, name):
    outcome = runs[name]
    assert outcome.status == 0, outcome.err
    assert max(np.mean(outcome.scores[:12]), np.mean(outcome.scores[12:])) < SCENARIOS[name]
    last = [row for row in outcome.rows("gospa.csv") if row["step"] == "11"]
    assert [(row["num_truth"], row["num_estimated"]) for row in last] == [("2", "2")] * 2
    assert "WARNING" not in outcome.log


def test_a_track_goes_through_the_seam_under_one_label(runs):
    """From bearing 90 on by 9 degrees a step: in step 11 it is at -171."""
    rows = [row for row in runs["all_round"].rows("tracks.csv") if row["run"] == "0"]
    first = [row for row in rows if row["label"] == "1"]
    bearing = [float(row["bearing_deg"]) for row in first]
    assert len(first) >= 11
    assert all(-180 <= value < 180 for value in bearing)
    assert bearing[0] > 80
    assert abs(bearing[-1] + 171) < 5
    assert max(float(row["std_bearing_deg"]) for row in first) < 5


def test_a_recorded_source_goes_through_the_seam_under_one_label(launch, tmp_path):
    """A loudspeaker around a drone with four microphones, through 180 degrees in step 10 of the first 20."""
    folder = os.environ.get("TORCHDT_DATA")
    if not folder or not (Path(folder) / "drone").is_dir():
        pytest.skip("real recording: TORCHDT_DATA names no folder that holds drone")
    arrays = dict(np.load(Path(folder) / "drone" / "one_a.npz"))
    cosine, sine = arrays["truth"][:20].T
    arrays |= {
        "snapshots": arrays["snapshots"][:20],
        "truth": 90 - np.rad2deg(np.arctan2(sine, cosine)).T[..., None],
    }
    np.savez(tmp_path / "one_a.npz", **arrays)
    data = (
        "data=npz",
        f"data.path={tmp_path / 'one_a.npz'}",
        "model.survival=0.98",
        "tracker.particles=100",
    )
    outcome = launch("scenario=all_round", *data, small=False)
    assert outcome.status == 0, outcome.err
    rows = outcome.rows("tracks.csv")
    # In its first step, in a room with echoes, it may as well be a signal of free signature.
    assert [(row["step"], row["label"]) for row in rows] == [(str(k), "1") for k in range(1, 20)]
    assert {float(row["bearing_deg"]) > 0 for row in rows} == {True, False}
    assert np.mean(outcome.scores) < 10


def test_a_detector_sees_directions_too(launch):
    size = ("scenario.num_steps=8", "tracker.particles=500")
    outcome = launch("scenario=planar_array", "tracker=mp_bp", *size, small=False)
    assert outcome.status == 0, outcome.err
    assert outcome.scores[4] < 0.1  # one object, known for some steps


def test_nothing_is_declared_below_the_horizon(launch):
    """An object that sinks to 0.997 of the circle, where its likelihood reaches beyond."""
    path = "scenario.paths.sinking={times_s: [0, 12], positions: [[0.66, 0.66], [0.705, 0.705]]}"
    only = ("~scenario.sources.overhead", "scenario.sources.sinking.birth=0", "runs=2")
    outcome = launch("scenario=planar_array", path, *only, *SIZE, small=False)
    rows = outcome.rows("tracks.csv")
    assert len(rows) >= 16
    assert all(math.hypot(float(row["east_cos"]), float(row["north_cos"])) <= 1 for row in rows)


def test_surface_is_drawn(launch):
    outcome = launch("scenario=planar_array", "logging=default", *SIZE, "scenario.num_steps=3", small=False)
    assert outcome.status == 0, outcome.err
    assert (outcome.directory / "figures" / "surface.png").exists()


@pytest.mark.parametrize("tracker", ["direct", "mp_bp"])
def test_trackers_search_the_circle_alone(settings, tracker):
    """Of 20 x 20 cells; 8 touch the circle with a corner, on which rounding decides."""
    composed = settings("scenario=planar_array", f"tracker={tracker}", small=False)
    region = build_tracker(composed, build_recording(composed)).region
    centre = (torch.arange(20.0) - 9.5).abs()
    nearest = torch.cartesian_prod(centre, centre) - 0.5
    assert (
        int((nearest.norm(dim=-1) < 9.99).sum())
        <= region.num_cells
        <= int((nearest.norm(dim=-1) < 10.01).sum())
    )


def test_positions_of_a_file_replace_the_configured_ones(launch, runs, settings, tmp_path):
    name = "planar_array"
    composed = settings(f"scenario={name}", "runs=2", *SIZE, small=False)
    recording = build_recording(composed)
    places = torch.tensor(composed.field["sensor_positions"], dtype=torch.float64)
    write_npz(tmp_path / "a.npz", dataclasses.replace(recording, sensor_positions=places))
    wrong = f"field.sensor_positions={(1.5 * places).tolist()}"
    data = ("data=npz", f"data.path={tmp_path}/a.npz")
    outcome = launch(f"scenario={name}", *data, wrong, *SIZE, small=False)
    assert outcome.status == 0, outcome.err
    assert outcome.scores == pytest.approx(runs[name].scores, rel=1e-3, abs=1e-6)
    write_npz(tmp_path / "a.npz", recording)
    assert np.mean(launch(f"scenario={name}", *data, wrong, *SIZE, small=False).scores) > SCENARIOS[name]


@pytest.mark.parametrize(
    ("name", "override", "words"),
    [
        (
            "planar_array",
            "field.coordinates=bearing",
            "'scenario.coordinates': found 2 coordinates, expected 1",
        ),
        ("near_field", "field.num_coordinates=3", "'scenario.coordinates': found 2 coordinates, expected 3"),
    ],
)
def test_what_does_not_fit_is_named(launch, name, override, words):
    outcome = launch(f"scenario={name}", override, small=False)
    assert outcome.status == 1
    assert words in outcome.err


def test_a_recording_of_fewer_sensors_is_named(launch, settings, tmp_path):
    composed = settings("scenario=near_field", *SIZE, small=False)
    recording = build_recording(composed)
    fewer = dataclasses.replace(recording, snapshots=recording.snapshots[..., :-1])
    write_npz(tmp_path / "a.npz", fewer)
    outcome = launch("scenario=near_field", "data=npz", f"data.path={tmp_path}/a.npz", *SIZE, small=False)
    assert outcome.status == 1
    assert "'snapshots': found 14 sensors, expected 15 sensors, as the field has" in outcome.err


def test_aliasing_is_warned_of_once_in_a_run(launch):
    outcome = launch(
        "scenario=near_field", "field.freqs=[700,1013]", *SIZE, "scenario.num_steps=2", small=False
    )
    assert outcome.log.count("more than half the wavelength") == 1


def test_fields_follow_type_of_the_tracker(settings):
    for name in SCENARIOS:
        field = build_field(settings(f"scenario={name}", small=False).field, torch.float32, "cpu")
        assert field(torch.full((2,), 0.5)).dtype == torch.complex64
