"""Run directories in, one table out; the runs are made by the jobs themselves."""

import csv
import json

import matplotlib
import numpy as np
import pytest
import torch
from oracles.scripts import SMALL, call, load
from scipy.stats import t as student

from recordings.tart_score import SkyScore
from torchdt.app import collect
from torchdt.app.collect import choose, differing, find_directories, gather, main, summarise
from torchdt.app.report.collect import Row, interval_figure
from torchdt.app.report.collect_runs import Run

pytestmark = pytest.mark.slow
QUIET = ("scenario=line_array", "scenario.num_steps=3", "logging=quiet")
SIZE = (*SMALL, *QUIET)
PARTICLES, SEEDS = (60, 100), (0, 1, 2)


def track(directory, *arguments, small=True):
    size = SIZE if small else QUIET
    status, _, err = call(load("track"), f"hydra.run.dir={directory}", *size, *arguments)
    assert status == 0, err
    return directory


def json_of(path):
    return json.loads(path.read_text())


def rows_of(*roots):
    return summarise(gather(find_directories(roots))[0])


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Two settings, three seeds each; the jobs of a third setting fail."""
    directory = tmp_path_factory.mktemp("sweep")
    combinations = ("tracker.particles=60,100,-1", "seed=0,1,2")
    status, _, err = call(load("track"), "-m", f"hydra.sweep.dir={directory}", *SIZE, *combinations)
    assert status == 1, err
    return directory


@pytest.fixture(scope="module")
def scores(sweep):
    """GOSPA of the jobs by number of particles, as they wrote it."""
    done = [json_of(path) for path in sweep.glob("*/metrics.json")]
    assert len(done) == len(PARTICLES) * len(SEEDS)
    values = {particles: [] for particles in PARTICLES}
    for directory in sorted(sweep.glob("[0-5]")):
        particles = json_of(directory / "manifest.json")["config"]["tracker"]["particles"]
        values[particles].append(json_of(directory / "metrics.json")["gospa"]["mean"])
    return values


def test_a_row_for_each_setting_with_mean_and_interval(sweep, scores):
    rows = rows_of(sweep)
    assert [row.setting for row in rows] == [{"tracker.particles": number} for number in PARTICLES]
    for row, values in zip(rows, scores.values(), strict=True):
        assert row.runs == len(SEEDS)
        assert row.means["gospa"] == pytest.approx(np.mean(values))
        half = student.ppf(0.975, 2) * np.std(values, ddof=1) / np.sqrt(3)
        assert row.intervals["gospa"] == pytest.approx(half)
        assert row.means["log_likelihood"] != 0


def test_single_directories_are_as_good_as_their_sweep(sweep):
    assert rows_of(*(sweep / str(job) for job in range(6)), sweep) == rows_of(sweep)


def test_directories_in_the_order_of_their_numbers(tmp_path):
    for name in ("10", "9", "late"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "manifest.json").touch()
    assert [path.name for path in find_directories([tmp_path])] == ["9", "10", "late"]


@pytest.mark.parametrize(
    ("settings", "chosen", "names"),
    [
        (("slots", "births"), {"births"}, ["births"]),  # slots follow
        (("slots", "births"), {"slots", "births"}, ["slots", "births"]),
        (("slots", "births", "seed", "data.seed"), set(), ["slots"]),
    ],
)
def test_what_differs(settings, chosen, names):
    runs = [Run(dict.fromkeys(settings, value) | {"dtype": "float32"}, chosen, {}, 1) for value in (4, 8)]
    assert differing(runs) == names


@pytest.mark.parametrize(
    ("known", "wanted", "shown"),
    [
        (("missed", "log_likelihood", "gospa"), None, ["gospa", "log_likelihood"]),
        (("missed", "gospa"), ["missed"], ["missed"]),
        (("speed", "seconds"), None, ["speed"]),
    ],
)
def test_metrics_that_are_shown(known, wanted, shown):
    assert choose([Row({}, 1, dict.fromkeys(known, 1.0), {})], wanted) == shown


def test_command_line(sweep, tmp_path, capsys):
    table, figure = tmp_path / "runs.csv", tmp_path / "runs.png"
    main([str(sweep), "--csv", str(table), "--figure", str(figure)])
    out = " ".join(capsys.readouterr().out.split())
    assert "tracker.particles" in out
    assert out.count("left out:") == len(SEEDS)
    assert "found -1, expected a positive integer" in out
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["tracker.particles"] for row in rows] == ["60", "100"]
    assert float(rows[0]["gospa"]) == pytest.approx(rows_of(sweep)[0].means["gospa"])
    assert float(rows[0]["missed_ci"]) >= 0
    assert matplotlib.image.imread(figure).std() > 0


def test_the_figure_shows_the_metric_that_is_wanted(sweep, tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(
        collect, "interval_figure", lambda *of: figures.append(interval_figure(*of)) or figures[-1]
    )
    main([str(sweep / "0"), "--figure", str(tmp_path / "runs.png"), "--metric", "missed"])
    assert [figure.axes[0].get_ylabel() for figure in figures] == ["missed"]


def test_sequences_of_a_batch_count_one_by_one(tmp_path, sweep):
    """A batch of three seeds has the GOSPA of three jobs."""
    (row,) = rows_of(track(tmp_path, "tracker.particles=60", "runs=3"))
    alone = rows_of(sweep)[0]
    assert (row.runs, row.setting) == (3, {})
    assert row.means["gospa"] == pytest.approx(alone.means["gospa"], rel=1e-3)
    assert row.intervals["gospa"] == pytest.approx(alone.intervals["gospa"], rel=1e-3)
    assert np.isnan(row.intervals["seconds"])  # one number for the batch


def test_an_option_stands_for_all_that_it_holds(tmp_path):
    for name in ("direct", "mp_bp"):
        track(tmp_path / name, f"tracker={name}", small=False)
    rows = rows_of(tmp_path)
    assert [row.setting for row in rows] == [{"tracker": "direct"}, {"tracker": "mp_bp"}]
    assert "log_likelihood" in rows[0].means
    assert np.isnan(rows[1].means["log_likelihood"])


def test_variants_are_settings(tmp_path):
    """Those of one directory, and the plain run that one of them repeats."""
    track(tmp_path / "many", "variants=[{power_shape: 1e4},{likelihood_power: 0.1}]", "runs=2")
    track(tmp_path / "one", "seed=5")
    rows = rows_of(tmp_path)
    name = "model.likelihood_power"
    assert [row.setting for row in rows] == [{name: 1.0}, {name: 0.1}]
    assert [row.runs for row in rows] == [3, 2]
    with (tmp_path / "many" / "variants.csv").open(newline="") as file:
        second = list(csv.DictReader(file))[1]
    assert rows[1].means["gospa"] == pytest.approx(float(second["gospa"]))
    assert rows[1].means["gospa"] != pytest.approx(rows[0].means["gospa"])
    assert rows[1].means["log_likelihood"] == pytest.approx(float(second["log_likelihood"]))


def test_tuning(tmp_path):
    steps = ("tuning.steps=1", "tuning.slice_points=0", "train_seeds=[0]", "heldout_seeds=[7]")
    status, _, err = call(load("tune"), f"hydra.run.dir={tmp_path}", *SIZE, *steps)
    assert status == 0, err
    (row,) = rows_of(tmp_path)
    assert row.means["heldout.after"] == json_of(tmp_path / "tuning.json")["heldout"]["after"]
    assert "steps" in row.means
    assert not any(name.startswith(("start", "best")) for name in row.means)


def test_the_sky(tmp_path):
    score = SkyScore(*range(len(SkyScore._fields)))._asdict()
    (tmp_path / "tart.json").write_text(json.dumps({"direct": score, "peaks": {**score, "switches": None}}))
    (tmp_path / "manifest.json").write_text(json.dumps({"config": {"seed": 3}}))
    (row,) = rows_of(tmp_path)
    assert row.means["direct.gospa"] == score["gospa"]
    assert "peaks.gospa" in row.means
    assert "peaks.switches" not in row.means


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({}, "no results"),
        ({"job.json": {"status": "running"}, "metrics.json": {"seconds": 1.0}}, "the job has not ended"),
        ({"metrics.json": [1]}, "a JSON object"),
    ],
)
def test_what_is_unfinished_is_left_out(sweep, tmp_path, content, words):
    (tmp_path / "manifest.json").write_text("{}")
    for name, value in content.items():
        (tmp_path / name).write_text(json.dumps(value))
    runs, left_out = gather([*find_directories([sweep / "0", tmp_path])])
    assert len(runs) == 1
    assert str(tmp_path) in left_out[0]
    assert words in left_out[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], ("path 'nowhere'", "no such directory")),
        (["empty"], ("path 'empty'", "no runs")),
        (["sweep/6"], ("no run that is complete", "found -1")),
        (["sweep", "--metric", "speed"], ("key 'metric'", "found speed", "gospa", "log_likelihood")),
        (["sweep", "--figure", "runs.doc"], ("path 'runs.doc'", "ending 'doc'", "png")),
        (["sweep", "--csv", "nowhere/runs.csv"], ("nowhere/",)),
    ],
)
def test_bad_input(sweep, tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "sweep").symlink_to(sweep)
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 1
    message = capsys.readouterr().err
    assert all(word in message for word in words), message
    assert not any(tmp_path.glob("runs.*"))


STRANGE = "[red]a[/nope] $x_{1$ :smile: \u00b2"


def test_one_bad_directory_is_listed_and_names_are_no_markup(tmp_path, capsys):
    """Whatever strangers call their settings and folders, and whatever a folder holds."""
    for number, name in enumerate((STRANGE, "$\\frac{$", "plain")):
        directory = tmp_path / str(number)
        directory.mkdir()
        config = {"scenario.name": name, "[bold]": name}
        (directory / "manifest.json").write_text(json.dumps({"config": config}))
        (directory / "metrics.json").write_text(json.dumps({"seconds": number, "$\\frac{$": 1.0}))
    bad = tmp_path / "\u00b2" / b"no text \xff [/x]".decode(errors="surrogateescape")
    bad.mkdir(parents=True)
    (bad / "manifest.json").write_text("[" * 10**5)
    figure, table = tmp_path / "runs.png", tmp_path / "runs.csv"
    main([str(tmp_path), "--figure", str(figure), "--csv", str(table), "--metric", "$\\frac{$"])
    out = "".join(capsys.readouterr().out.split())
    assert "[red]a[/nope]$x_{1$:smile:\u00b2" in out
    assert out.count("leftout:") == 1
    assert "notext\\udcff[/x]" in out
    assert "RecursionError" in out
    assert matplotlib.image.imread(figure).std() > 0


def test_script():
    assert load("collect").main is main


def test_confidence_is_over_all_runs_of_a_setting(sweep, scores):
    fewer = rows_of(*(sweep / str(job) for job in (0, 1, 3, 4, 5)))
    assert fewer[0].runs == 2
    assert fewer[0].means["gospa"] == pytest.approx(torch.tensor(scores[60][:2]).mean().item())
