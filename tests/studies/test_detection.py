import csv
import json

import pytest
import torch
from oracles.scripts import call, configuration, load

from studies.detection import DetectionSettings, simulate_levels, track_settings
from studies.detection_report import BOUND
from torchdt.app.targets import build_field
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow
SMALL = ("scenario.num_steps=6", "tracker.slots=4", "tracker.particles=100", "logging=quiet")


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """A level at which nothing can be seen and one at which all is."""
    directory = tmp_path_factory.mktemp("detection")
    overrides = ",".join(f'"{o}"' for o in SMALL)
    status, out, err = call(
        load("detection"),
        f"hydra.run.dir={directory}",
        "hydra/job_logging=none",
        f"overrides=[{overrides}]",
        *("levels=[-30,20]", "trackers=[direct,mp_bp]", "runs=2", "noise_runs=1", "within=[2,6]", "shown=6"),
    )
    assert status == 0, err
    return directory, out


def test_every_tracker_has_its_rows(outcome):
    with (outcome[0] / "detection.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    keys = [(row["tracker"], row["within"], row["level_db"]) for row in rows]
    levels = [(steps, level) for steps in ("2", "6") for level in ("-30.0", "20.0")]
    assert keys == [(tracker, *level) for tracker in ("direct", "mp_bp", BOUND) for level in levels]
    for row in rows:
        assert int(row["runs"]) == 2
        assert int(row["declared"]) == 2 * float(row["probability"])
        assert float(row["low"]) <= float(row["probability"]) <= float(row["high"])
    shares = {key: float(row["probability"]) for key, row in zip(keys, rows, strict=True)}
    for tracker in ("direct", "mp_bp", BOUND):
        assert shares[tracker, "6", "20.0"] == 1
    assert shares[BOUND, "6", "-30.0"] == 0


def test_what_follows_from_them(outcome):
    trackers = json.loads((outcome[0] / "detection.json").read_text())["trackers"]
    assert list(trackers) == ["direct", "mp_bp", BOUND]
    for content in trackers.values():
        assert content["level_of_half_db"]["6"] == pytest.approx(-5)
        assert content["from_bound_db"]["6"] == pytest.approx(0)
        value, low, high = content["false_per_hour"]
        assert low <= value <= high
        assert value == pytest.approx(content["false_tracks"] * 600)  # six steps of one second


def test_table_figure_and_events(outcome):
    directory, out = outcome
    assert "Share of sources declared within 6 steps" in out
    assert all(name in out for name in ("direct", "mp_bp", BOUND, "-30 dB", "20 dB"))
    assert (directory / "figures" / "detection.png").stat().st_size > 1000
    assert len(list((directory / "tensorboard").iterdir())) == 1
    assert (directory / "manifest.json").is_file()


def test_levels_are_those_of_an_element():
    """What a source adds at a level of 0 dB is the noise of every element."""
    settings = DetectionSettings(levels=[-400.0, 0.0], trackers=["direct"], runs=3, noise_runs=2, within=[30])
    with configuration():
        chosen = track_settings(settings, "direct")
    sequences = simulate_levels(chosen, settings)
    assert sequences.seeds == [0, 1, 2, 0, 1, 2, 0, 1]
    assert sequences.hours == pytest.approx(2 * 100 / 3600)
    z = sequences.recording.snapshots
    noise, heard, alone = z[:3], z[3:6], z[6:]
    torch.testing.assert_close(noise[:2], alone)  # of the same random numbers
    signal = heard - noise
    field = build_field(chosen.field, torch.float64, "cpu")
    response = field(sequences.track)[:, :, None]  # (K, I, 1, M)
    along = (response.conj() * signal).sum(-1, keepdim=True)
    torch.testing.assert_close(along * response, signal)
    # 1800 amplitudes of two degrees of freedom: 5 standard errors, twice a false alarm of 3e-7.
    ratio = signal.abs().square().mean() / noise.abs().square().mean()
    assert ratio.item() == pytest.approx(1, abs=5 * (1 / 1800 + 1 / 14400) ** 0.5)


@pytest.mark.parametrize(
    ("key", "value"),
    [("levels", []), ("levels", [3.0, 0.0]), ("trackers", []), ("trackers", ["a", "a"]), ("shown", 20)],
)
def test_settings_that_do_not_fit(key, value):
    with pytest.raises(InputError, match=f"key '{key}'"):
        DetectionSettings(**({"levels": [0.0], "trackers": ["direct"]} | {key: value}))


@pytest.mark.parametrize(
    ("scene", "override", "key"),
    [
        ("line_faint_pair", "logging=quiet", "scene"),
        ("line_faint", "scenario.sources.faint.birth=3", "scene"),
        ("line_faint", "scenario.num_steps=50", "scenario.num_steps"),
    ],
)
def test_scenarios_that_do_not_fit(scene, override, key):
    settings = DetectionSettings(scene=scene, levels=[0.0], trackers=["direct"], overrides=[override])
    with configuration(), pytest.raises(InputError, match=f"key '{key}'"):
        track_settings(settings, "direct")
