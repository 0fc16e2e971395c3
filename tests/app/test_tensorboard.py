import csv
import json
from unittest import mock

import pytest
from oracles.board import serve, until
from oracles.events import hparams, images, layout, metric_columns, read, scalars
from oracles.scripts import SMALL, call, load

from torchdt.app.report.tensorboard import LAYOUT, TensorBoardReport
from torchdt.core.errors import InputError
from torchdt.run.keeper import ChunkKeeper

pytestmark = pytest.mark.slow
METRICS = {
    f"hparam/{name}"
    for name in (
        "gospa",
        "localisation",
        "missed",
        "false",
        "declared",
        "log_likelihood_per_step",
        "seconds",
        "steps_per_second",
    )
}
STEPS = list(range(5))


@pytest.fixture(scope="module")
def sweep(launch):
    """Two jobs, one for each of the kinds of trackers, in folders 0 and 1."""
    overrides = ("logging=default", "logging.interval=2", "tracker=direct,mp_bp", "seed=3", "runs=2")
    # SMALL sets what a tracker of points has no setting for.
    size = ("scenario=line_array", "scenario.num_steps=5", "tracker.slots=4", "tracker.particles=100")
    outcome = launch("-m", *size, *overrides, small=False)
    assert outcome.status == 0, outcome.out + outcome.err
    return outcome


@pytest.fixture(scope="module")
def direct(sweep):
    return read(sweep.directory / "0" / "tensorboard")


@pytest.fixture(scope="module")
def points(sweep):
    return read(sweep.directory / "1" / "tensorboard")


def test_every_step_is_there_once(direct, points):
    for events in (direct, points):
        for tag in ("gospa/total", "count/declared", "count/true"):
            assert [step for step, _ in scalars(events, tag)] == STEPS
    assert [step for step, _ in scalars(direct, "log_evidence")] == STEPS
    assert "log_evidence" not in points.Tags()["scalars"]  # which a tracker of points does not know


@pytest.mark.parametrize("name", ["direct", "points"])
def test_beliefs_at_the_interval(name, request):
    events = request.getfixturevalue(name)
    assert [event.step for event in events.Histograms("belief/existence")] == [0, 2, 4]
    counts = [event.histogram_value.num for event in events.Histograms("belief/existence")]
    assert all(1 <= count <= 4 for count in counts)
    power = events.Histograms("belief/power_db/label_01")[-1]
    assert (power.step, power.histogram_value.num) == (4, pytest.approx(2, rel=0.05))  # tones
    clouds = images(events, "belief/particles")
    assert list(clouds) == [0, 2, 4]
    assert all(image[..., :3].std() > 0.02 for image in clouds.values())


def test_powers_of_beliefs_are_those_of_the_estimates(direct):
    """In units of the recording, which are not the tracker's."""
    histogram = direct.Histograms("belief/power_db/label_01")[-1].histogram_value
    last = [scalars(direct, f"power_db/label_01/tone_{tone}")[-1][1] for tone in (1, 2)]
    assert histogram.min < min(last) < max(last) < histogram.max
    assert histogram.sum / histogram.num == pytest.approx(sum(last) / 2, abs=1.5)


def test_charts(direct, points):
    assert layout(direct) == layout(points) == LAYOUT


def test_a_row_for_each_job(direct, points):
    for events, tracker, particular in (
        (direct, "direct", {"model.power.power_shape": 1e4, "model.likelihood_power": 1.0}),
        (points, "mp_bp", {"tracker.detection_probability": 0.9}),
    ):
        row = hparams(events)
        same = {"scenario": "line_array", "seed": 3, "runs": 2, "dtype": "float32", "tracker": tracker}
        assert (same | {"tracker.particles": 100, "scenario.num_steps": 5}).items() <= row.items()
        assert set(particular) <= set(row)
        assert not any(name.startswith("logging") for name in row)
        assert metric_columns(events) == METRICS


def test_metrics_of_the_row_are_those_of_the_files(sweep, direct, points):
    for folder, events in (("0", direct), ("1", points)):
        metrics = json.loads((sweep.directory / folder / "metrics.json").read_text())
        found = {tag: scalars(events, tag) for tag in METRICS & set(events.Tags()["scalars"])}
        assert {step for values in found.values() for step, _ in values} == {4}
        values = {tag.removeprefix("hparam/"): value for tag, ((_, value),) in found.items()}
        assert values["gospa"] == pytest.approx(metrics["gospa"]["mean"])
        for part in ("localisation", "missed", "false"):
            assert values[part] == pytest.approx(metrics["gospa"][part])
        assert values["seconds"] == pytest.approx(metrics["seconds"])
        assert values["steps_per_second"] == pytest.approx(metrics["steps_per_second"])
        if metrics["log_likelihood"] is None:
            assert "log_likelihood_per_step" not in values
        else:
            assert values["log_likelihood_per_step"] == pytest.approx(metrics["log_likelihood"] / 5)
        with (sweep.directory / folder / "gospa.csv").open(newline="") as file:
            declared = [int(row["num_estimated"]) for row in csv.DictReader(file)]
        assert values["declared"] == pytest.approx(sum(declared) / len(declared))


def test_a_run_that_goes_on_shows_every_step_once(tmp_path):
    """Events are written up to step 3, the run goes on after step 1."""
    arguments = (
        "scenario=line_array",
        *SMALL,
        "logging.interval=2",
        "logging.figures=false",
        f"hydra.run.dir={tmp_path}",
    )
    write, keep = TensorBoardReport.add_step, ChunkKeeper.__call__

    def stop_at_3(report, step, *more):
        write(report, step, *more)
        report.flush()
        if step == 3:
            raise KeyboardInterrupt

    def keep_until_1(keeper, step, *more):
        if step <= 1:
            keep(keeper, step, *more)

    with (
        mock.patch.object(TensorBoardReport, "add_step", stop_at_3),
        mock.patch.object(ChunkKeeper, "__call__", keep_until_1),
    ):
        assert call(load("track"), *arguments, "checkpoint_s=1e-6")[0] == 130
    before = read(tmp_path / "tensorboard")
    assert [step for step, _ in scalars(before, "count/declared")] == STEPS[:4]

    status, out, err = call(load("track"), *arguments, "checkpoint_s=1e-6")
    assert status == 0, out + err
    after = read(tmp_path / "tensorboard")
    for tag in ("count/declared", "gospa/total", "log_evidence"):
        assert [step for step, _ in scalars(after, tag)] == STEPS
    assert scalars(after, "log_evidence")[:4] == scalars(before, "log_evidence")
    assert [event.step for event in after.Histograms("belief/existence")] == [0, 2, 4]
    assert after.Tags()["images"] == []  # logging.figures=false
    assert metric_columns(after) == METRICS


@pytest.mark.parametrize("interval", ["0", "-5"])
def test_an_interval_is_a_number_of_steps(settings, interval):
    with pytest.raises(
        InputError, match=rf"'logging\.interval': found {interval}, expected a positive integer"
    ):
        settings(f"logging.interval={interval}")


@pytest.fixture(scope="module")
def ask(sweep, tmp_path_factory):
    log = tmp_path_factory.mktemp("server") / "log"
    jobs = {f"{job}/tensorboard" for job in (0, 1)}
    with serve(sweep.directory, log) as ask:
        until(lambda: jobs == set(ask("scalars/tags")) == set(ask("images/tags")))
        yield ask


def test_server_shows_all_tags(ask, direct):
    served = {kind: set(ask(f"{kind}/tags")["0/tensorboard"]) for kind in ("scalars", "images", "histograms")}
    written = {kind: set(direct.Tags()[kind]) for kind in served}
    assert served == written
    assert {"gospa/total", "count/declared", "existence/label_01", *METRICS} <= served["scalars"]
    assert served["images"] == {"belief/particles", "figures/tracks", "figures/gospa", "figures/surface"}
    assert {"belief/existence", "belief/power_db/label_01"} <= served["histograms"]


def test_server_merges_the_charts_of_both_jobs(ask):
    found = {
        category["title"]: {chart["title"]: chart["multiline"]["tag"] for chart in category["chart"]}
        for category in ask("custom_scalars/layout")["category"]
    }
    assert found == LAYOUT
    answer = ask("custom_scalars/scalars?run=1/tensorboard&tag=gospa/.*")
    assert set(answer["tag_to_events"]) == {
        f"gospa/{p}" for p in ("total", "localisation", "missed", "false")
    }
    assert [step for _, step, _ in answer["tag_to_events"]["gospa/total"]] == STEPS


def test_server_has_one_row_for_each_job(ask):
    experiment = ask("hparams/experiment", {})
    assert {"scenario", "tracker", "seed", "tracker.particles"} <= {
        p["name"] for p in experiment["hparamInfos"]
    }
    assert {info["name"]["tag"] for info in experiment["metricInfos"]} == METRICS
    query = {"startIndex": 0, "sliceSize": 9, "allowedStatuses": ["STATUS_SUCCESS"]}
    query["colParams"] = [{"metric": info["name"]} for info in experiment["metricInfos"]]
    rows = ask("hparams/session_groups", query)["sessionGroups"]
    assert sorted(row["hparams"]["tracker"] for row in rows) == ["direct", "mp_bp"]
    for row in rows:
        assert len(row["sessions"]) == 1
        found = {metric["name"]["tag"] for metric in row["metricValues"]}
        assert {"hparam/gospa", "hparam/seconds"} <= found <= METRICS
