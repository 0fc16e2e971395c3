"""The conventional trackers as `tracker=mp_bp` and `tracker=sbl_bp` of `experiments/track.py`."""

import pytest
from oracles.scripts import SMALL, call, load
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from torchdt.app.tunable import build_problem
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow
LINE = ("scenario=line_array", "scenario.num_steps=6", "runs=2", "seed=3", "logging=default")
# Two tones in three snapshots say little: a single step leaves a source at 10 to 20 nats.
POINTS = (
    "tracker.slots=4",
    "tracker.particles=100",
    "tracker.detection_probability=0.9",
    "tracker.clutter_mean=1",
    "tracker.detector.points=4",
    "tracker.detector.threshold=8",
)
FAST = {"mp_bp": (), "sbl_bp": ("tracker.detector.max_iterations=20",)}
TINY = ("scenario=line_array", "scenario.num_steps=2", *POINTS)


@pytest.fixture(scope="module")
def direct(launch):
    return launch(*SMALL, *LINE, small=False)


@pytest.fixture(scope="module", params=FAST)
def run(launch, request):
    name = request.param
    return name, launch(f"tracker={name}", *LINE, *POINTS, *FAST[name], small=False)


def test_same_files_and_columns_as_direct_tracking(run, direct):
    _, outcome = run
    assert outcome.status == 0, outcome.err
    folders = [outcome.directory, direct.directory]
    names, figures = (
        [sorted(path.name for path in (folder / part).iterdir()) for folder in folders]
        for part in ("", "figures")
    )
    assert names[0] == names[1]
    assert figures[0] == figures[1]
    for table in ("gospa.csv", "tracks.csv"):
        assert outcome.columns(table) == direct.columns(table)


def test_metrics_name_the_tracker_and_know_no_likelihood(run, direct):
    name, outcome = run
    metrics, reference = (o.json("metrics.json") for o in (outcome, direct))
    assert list(metrics) == list(reference)
    assert (metrics["tracker"], reference["tracker"]) == (name, "direct")
    assert metrics["log_likelihood"] is None
    assert isinstance(reference["log_likelihood"], float)
    assert metrics["gospa"]["mean"] == pytest.approx(outcome.values[0])
    assert metrics["steps_per_second"] == pytest.approx(12 / metrics["seconds"])


def test_tracks_hold_what_was_declared(run):
    _, outcome = run
    rows = outcome.rows("tracks.csv")
    declared = [int(row["num_estimated"]) for row in outcome.rows("gospa.csv")]
    assert len(rows) == sum(declared) > 0
    assert all(float(row["power_1"]) > 0 for row in rows)
    # The source is near -40 degrees in both runs; the second one is born later.
    assert [float(row["bearing_deg"]) for row in rows if row["step"] == "5"] == pytest.approx(
        [-37] * 2, abs=5
    )


def test_closing_table_and_events_show_no_likelihood(run):
    name, outcome = run
    assert f"tracker {name}, line_array" in outcome.out
    assert "nan" not in outcome.out
    tags = EventAccumulator(str(outcome.directory / "tensorboard")).Reload().Tags()["scalars"]
    assert "log_evidence" not in tags
    assert {"gospa/total", "count/declared", "existence/label_01", "power_db/label_01/tone_2"} <= set(tags)


def test_manifest_holds_the_detector(run):
    name, outcome = run
    manifest = outcome.json("manifest.json")["config"]["tracker"]
    assert manifest["detector"]["threshold"] == 8
    assert ("sources" in manifest["detector"]) == (name == "sbl_bp")


def fails(status, message, words):
    assert status == 1
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    ("tracker", "override", "words"),
    [
        (
            "mp_bp",
            "model.motion.driving_variance=[1,2]",
            ("key 'model.motion.driving_variance'", "[1, 2]", "for each of 1"),
        ),
        (
            "mp_bp",
            "tracker.spread={range: -1}",
            ("key 'tracker.spread'", "found {'range': -1.0", "each a positive number"),
        ),
        ("mp_bp", "tracker.births=3", ("'births'", "not in 'TwoStepConfig'")),
        ("mp_bp", "tracker.detector=null", ("tracker.detector", "not Optional")),
        ("mp_bp", "tracker.detector.sources=3", ("'sources'", "not in 'PursuitConfig'")),
        (
            "mp_bp",
            "+tracker.detector.foo=1",
            ("key 'tracker.detector.foo'", "found an unknown key", "'threshold'"),
        ),
        ("sbl_bp", "tracker.detector.sources=99", ("key 'tracker.detector.sources'", "found 99", "the 8")),
    ],
)
def test_bad_settings(launch, tracker, override, words):
    outcome = launch(f"tracker={tracker}", *TINY, override, small=False)
    fails(outcome.status, outcome.err, words)
    assert not (outcome.directory / "metrics.json").exists()


def test_only_direct_tracking_is_tuned(settings, tmp_path):
    """The tracker on the paper's graph has no likelihood either."""
    paper = settings("tracker=direct_paper", "scenario=line_array", small=False)
    with pytest.raises(InputError, match="'tracker': found PaperConfig, expected settings of direct"):
        build_problem(paper, {}, [])
    conventional = settings("tracker=mp_bp", "scenario=line_array", small=False)
    with pytest.raises(InputError, match="'tracker': found TwoStepConfig, expected settings of direct"):
        build_problem(conventional, {}, [])
    status, _, err = call(load("tune"), "tracker=mp_bp", f"hydra.run.dir={tmp_path}")
    fails(status, err, ("tracker", "TwoStepConfig"))
    assert not (tmp_path / "tuning.json").exists()
