"""Every preset is started by the line at its top, in a tiny size."""

import json
from pathlib import Path

import pytest
from oracles.scripts import SMALL, call, configured, load

pytestmark = pytest.mark.slow
DOCS = Path(__file__).parents[2] / "docs"
PRESETS = configured("experiment/*.yaml")
OVERRIDES = 'overrides=["scenario.num_steps=5","tracker.slots=4","tracker.particles=100"]'
STARTS = {
    "paper": ("track", *SMALL, "calibration=none", "logging=quiet"),
    "suite": ("quality", "suite=[line_array]", "seeds=[0,1]", OVERRIDES),
    "monte_carlo": (
        "compare",
        "suite=[line_array]",
        "trackers=[direct]",
        "runs=2",
        OVERRIDES,
        "tensorboard=false",
    ),
    "tuning": (
        *("tune", *SMALL, "logging=quiet", "train_seeds=[0]", "heldout_seeds=[1]"),
        *("tuning.steps=1", "tuning.slice_points=0"),
    ),
    "silences": (
        *("tune", *SMALL, "logging=quiet", "scenario.num_steps=5", "train_seeds=[0]", "heldout_seeds=[1]"),
        "tuning.steps=1",
    ),
    "detection": (
        *("detection", "scene=line_faint", 'overrides=["scenario.num_steps=5","tracker.particles=50"]'),
        *(
            "levels=[0]",
            "trackers=[direct]",
            "runs=1",
            "noise_runs=1",
            "within=[5]",
            "shown=5",
            "tensorboard=false",
        ),
    ),
    "sweep": ("track", *SMALL, "tracker.particles=50,60", "model.survival=0.9", "seed=0"),
    # These need recordings: tests/recordings starts them.
    "drone": ("track",),
    "respeaker": ("track",),
    "lofar": ("track",),
}
RESULTS = {
    "paper": "metrics.json",
    "suite": "quality.json",
    "monte_carlo": "compare.json",
    "tuning": "tuned.yaml",
    "silences": "tuned.yaml",
    "detection": "detection.json",
}


def start(preset, script, *arguments):
    return call(load(script), f"+experiment={preset}", *arguments)


def test_all_are_known():
    assert set(STARTS) == set(PRESETS)


@pytest.mark.parametrize("preset", STARTS)
def test_its_line_is_at_the_top_and_in_the_documentation(preset):
    line = f"python experiments/{STARTS[preset][0]}.py +experiment={preset}"
    assert line in PRESETS[preset].read_text()
    assert line in (DOCS / "launching.md").read_text()


@pytest.mark.parametrize("preset", RESULTS)
def test_starts(preset, tmp_path):
    status, _, err = start(preset, *STARTS[preset], f"hydra.run.dir={tmp_path}")
    assert status == 0, err
    assert (tmp_path / RESULTS[preset]).is_file()


def test_the_paper_runs_its_own_scenario(tmp_path):
    status, out, _ = start("paper", "track", "--cfg", "job")
    assert status == 0
    assert "name: swellex96" in out
    assert "num_steps: 292" in out


def test_the_sweep_is_one_without_being_asked(tmp_path):
    """`-m` is in the preset, and so are values; those of the command line go before them."""
    _, out, err = start("sweep", "track", "--cfg", "hydra", "-p", "hydra.sweeper.params")
    assert "tracker.particles: 100,300,1000" in out, err
    status, _, err = start("sweep", *STARTS["sweep"], f"hydra.sweep.dir={tmp_path}")
    assert status == 0, err
    jobs = json.loads((tmp_path / "sweep.json").read_text())["jobs"]
    particles = [o for job in jobs for o in job["overrides"] if o.startswith("tracker.particles=")]
    assert particles == ["tracker.particles=50", "tracker.particles=60"]


@pytest.mark.parametrize("preset", ["suite", "monte_carlo"])
def test_suites_name_what_there_is(preset):
    _, out, _ = start(preset, STARTS[preset][0], "--cfg", "job")
    assert out.count("- ") > 5
    listed = {line.removeprefix("- ") for line in out.splitlines() if line.startswith("- ")}
    known = configured("scenario/*.yaml").keys() | configured("tracker/*.yaml")
    assert {name for name in listed if not name.isdigit()} <= known


@pytest.mark.parametrize(
    ("preset", "script", "words"),
    [
        ("nowhere", "track", ("Could not find 'experiment/nowhere'", *PRESETS)),
        ("suite", "track", ("In 'experiment/suite'", "not in 'TrackSettings'")),
        ("tuning", "track", ("In 'experiment/tuning'", "override 'tuning'")),
        ("paper", "quality", ("In 'experiment/paper'", "override 'scenario'")),
    ],
)
def test_unknown_preset_or_one_of_another_job(preset, script, words):
    status, _, err = start(preset, script)
    assert status == 1
    assert all(word in err for word in words), err
