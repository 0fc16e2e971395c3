import matplotlib.image
import numpy as np
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

pytestmark = pytest.mark.slow
FILES = {
    "metrics.json",
    "gospa.csv",
    "energy.csv",
    "tracks.csv",
    "manifest.json",
    "figures",
    "tensorboard",
    "checkpoint.pt",
}
HYDRA = {".hydra", "track.log"}
LINE_ARRAY_COLUMNS = ["bearing_deg", "bearing_rate_degps"]
WAVEGUIDE_COLUMNS = ["range_m", "depth_m", "range_rate_mps", "depth_rate_mps"]


@pytest.fixture(scope="module")
def run(launch):
    return launch("logging=default", "runs=2", "seed=3")


@pytest.fixture(scope="module")
def waveguide(launch):
    """The SWellEx-96 scenario, short and at four of its tones."""
    size = ("scenario.num_steps=12", "field.freqs=[49,79,148,201]", "tracker.particles=200")
    return launch("logging=default", *size, "calibration=none", small=False)


@pytest.fixture(scope="module")
def events(run):
    accumulator = EventAccumulator(str(run.directory / "tensorboard"), size_guidance={"scalars": 0})
    return accumulator.Reload()


def test_files(run):
    assert run.status == 0, run.err
    assert {path.name for path in run.directory.iterdir()} == FILES | HYDRA


def test_quiet_run_writes_tables_alone(launch):
    found = {path.name for path in launch().directory.iterdir()}
    assert found == (FILES | HYDRA) - {"figures", "tensorboard"}


def test_metrics(run):
    metrics = run.json("metrics.json")
    assert list(metrics) == [
        "tracker",
        "num_steps",
        "num_runs",
        "seed",
        "log_likelihood",
        "failed_steps",
        "energy",
        "hints",
        "seconds",
        "steps_per_second",
        "gospa",
    ]
    assert metrics["failed_steps"] == 0
    assert list(metrics["gospa"]) == ["mean", "localisation", "missed", "false"]
    assert (metrics["tracker"], metrics["num_steps"], metrics["num_runs"], metrics["seed"]) == (
        "direct",
        5,
        2,
        3,
    )
    assert metrics["steps_per_second"] == pytest.approx(10 / metrics["seconds"])
    parts = metrics["gospa"]
    assert parts["mean"] == pytest.approx(parts["localisation"] + parts["missed"] + parts["false"])


def test_gospa_table(run):
    assert run.columns("gospa.csv") == (
        ["run", "step", "time_s", "gospa", "localisation", "missed", "false", "num_truth", "num_estimated"]
    )
    rows = run.rows("gospa.csv")
    assert [(row["run"], row["step"]) for row in rows] == [
        (str(b), str(k)) for b in range(2) for k in range(5)
    ]
    assert [float(row["time_s"]) for row in rows] == [0.5, 1.5, 2.5, 3.5, 4.5] * 2
    assert {row["num_truth"] for row in rows} == {"1"}  # the second source is born later


def test_value_is_mean_of_gospa_table(run):
    assert run.values == [pytest.approx(np.mean(run.scores), rel=1e-8)]
    assert run.json("metrics.json")["gospa"]["mean"] == pytest.approx(run.values[0])


def test_tracks_table(run):
    assert run.columns("tracks.csv") == (
        ["run", "step", "time_s", "label", "existence", *LINE_ARRAY_COLUMNS, "power_1", "power_2"]
        + [f"std_{column}" for column in LINE_ARRAY_COLUMNS]
        + ["transmission"]
    )
    rows = run.rows("tracks.csv")
    declared = [int(row["num_estimated"]) for row in run.rows("gospa.csv")]
    assert len(rows) == sum(declared) > 0
    for row in rows:
        assert float(row["time_s"]) == int(row["step"]) + 0.5
        assert int(row["label"]) >= 1
        assert 0.5 < float(row["existence"]) <= 1
        assert float(row["std_bearing_deg"]) > 0


def test_tracks_table_of_a_waveguide(waveguide):
    powers = [f"power_{i}" for i in range(1, 5)]
    assert waveguide.columns("tracks.csv") == (
        ["run", "step", "time_s", "label", "existence", *WAVEGUIDE_COLUMNS, *powers]
        + [f"std_{column}" for column in WAVEGUIDE_COLUMNS]
        + ["transmission"]
    )


def test_manifest(run):
    manifest = run.json("manifest.json")
    assert set(manifest) == {"config", "seed", "versions", "git_commit"}
    assert manifest["seed"] == 3
    assert manifest["config"]["tracker"]["particles"] == 100
    assert manifest["config"]["scenario"]["name"] == "line_array"
    assert manifest["versions"]["torch"]


@pytest.mark.parametrize("name", ["tracks", "gospa", "surface"])
@pytest.mark.parametrize("source", ["run", "waveguide"])
def test_figures_show_something(source, name, request):
    image = matplotlib.image.imread(request.getfixturevalue(source).directory / "figures" / f"{name}.png")
    assert min(image.shape[:2]) > 300
    assert image[..., :3].std() > 0.02  # of 0 to 1; a blank page has none


def test_events_repeat_the_table(run, events):
    scores = [scalar.value for scalar in events.Scalars("gospa/total")]
    np.testing.assert_allclose(scores, run.scores[:5], rtol=1e-6)
    counts = [scalar.value for scalar in events.Scalars("count/declared")]
    assert counts == [int(row["num_estimated"]) for row in run.rows("gospa.csv")[:5]]


def test_event_tags(events):
    tags = events.Tags()
    scalars = set(tags["scalars"])
    assert {f"gospa/{part}" for part in ("total", "localisation", "missed", "false")} <= scalars
    assert {"count/declared", "count/true", "log_evidence", "noise_db/tone_1", "noise_db/tone_2"} <= scalars
    assert {"existence/label_01", "effective_sample_size/label_01", "power_db/label_01/tone_2"} <= scalars
    pictures = {f"figures/{name}" for name in ("tracks", "gospa", "surface")}
    assert set(tags["images"]) == pictures | {"belief/particles"}
    assert set(tags["tensors"]) == {"config/text_summary", "custom_scalars__config__"}


def test_closing_table_and_directory(run):
    assert "GOSPA" in run.out
    assert str(run.directory) in run.out
    assert "2 runs of 5 steps" in run.out


def test_swellex_declares_both_sources(waveguide):
    assert waveguide.status == 0, waveguide.err
    last = [row for row in waveguide.rows("tracks.csv") if row["step"] == "11"]
    found = sorted((float(row["range_m"]), float(row["depth_m"])) for row in last)
    # Splines through the published ranges: 3765.5 m at step 50, 4140.9 m at step 11; both 58 m deep.
    expected = [(3765.5, 58), (4140.9, 58)]
    np.testing.assert_allclose(found, expected, atol=3)
    assert waveguide.values[0] < 20
