import csv
import json
import math
import time
from pathlib import Path
from unittest import mock

import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from oracles.scripts import call, load
from rich.console import Console

from torchdt.errors import InputError
from torchdt.experiment import benchmark
from torchdt.experiment.benchmark import BenchmarkSettings, clock, high_peaks, simulate_points
from torchdt.model.region import Coordinate, Region
from torchdt.mot.config import PointConfig
from torchdt.mot.likelihood import GaussianPosition
from torchdt.mot.tracker import PointTracker
from torchdt.report.benchmark import Measured, Plain, plain_rows, print_benchmark

DATA = '"scenario=line_array","scenario.num_steps=5","tracker.detector.tolerance=1e-3"'
SMALL = (f"overrides=[{DATA}]", "steps=2", "repeats=2", "particles=200")


def launch(directory, *overrides):
    place = (f"hydra.run.dir={directory}", "hydra/job_logging=none")
    return call(load("benchmark"), *place, *SMALL, *overrides)


def values_of(rows, part):
    """Values of one part by quantity."""
    return {row["quantity"]: row["value"] for row in rows if row["part"] == part}


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    directory = tmp_path_factory.mktemp("benchmark")
    _, out, _ = launch(directory)
    return out, directory, json.loads((directory / "benchmark.json").read_text())


def test_all_parts_are_measured_unless_told_otherwise():
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        settings = OmegaConf.to_object(compose("benchmark"))
    assert settings.parts == list(benchmark.PARTS)
    assert (settings.repeats, settings.particles, settings.device) == (3, 10_000, "cpu")


def test_the_default_data_are_of_the_papers_size(settings):
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        overrides = compose("benchmark").overrides
    track = settings("tracker=sbl_bp", *overrides, small=False)
    region, field = benchmark.build_region(track, torch.float32), track.field
    assert track.scenario.name == "matched_20"
    assert region.grid_shape == (200, 100)
    assert (len(field["element_depths"]), len(field["freqs"]), track.scenario.num_snapshots) == (21, 7, 3)


def test_detection_finds_the_peaks_of_the_plain_formulation(outcome):
    rows = outcome[2]["rows"]
    values = values_of(rows, "sbl")
    assert values["steps with identical peaks"] == 2
    (common,) = (row for row in rows if row["quantity"] == "peaks in common")
    assert common["unit"] == f"of {common['value']}"
    assert common["value"] >= 2
    assert values["iterations of torchdt"] == pytest.approx(values["iterations of matrix products"], rel=0.1)


def test_every_number_is_positive_and_finite(outcome):
    assert all(math.isfinite(row["value"]) and row["value"] > 0 for row in outcome[2]["rows"])


def test_the_outer_products_are_said_to_be_extrapolated(outcome):
    out, _, content = outcome
    said = [row["quantity"] for row in content["rows"] if "EXTRAPOLATED" in row["note"]]
    assert said == ["NumPy, outer products", "outer products / torchdt"]
    assert out.count("EXTRAPOLATED") == 2


def test_memory_is_that_of_a_process_of_its_own(outcome):
    values = values_of(outcome[2]["rows"], "sbl")
    assert values["peak memory of detection"] < values["peak memory of torchdt"] < 4096


def test_points_are_tracked_while_the_clock_runs(outcome):
    values = values_of(outcome[2]["rows"], "points")
    assert values["objects declared"] == pytest.approx(benchmark.OBJECTS, abs=0.5)
    assert benchmark.OBJECTS < values["objects carried"] <= PointConfig().slots
    assert values["torchdt"] <= values["torchdt, nine of ten steps"]


def test_the_files_agree_and_say_what_the_machine_is(outcome):
    _, directory, content = outcome
    with (directory / "benchmark.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [{**row, "value": float(row["value"])} for row in table] == content["rows"]
    machine = content["machine"]
    assert (machine["torch"], machine["threads"]) == (torch.__version__, torch.get_num_threads())
    assert machine["cores"] >= 1
    assert min(machine["torch_sgemm_gflops"], machine["numpy_sgemm_gflops"]) > 0
    assert (directory / "manifest.json").exists()


def test_without_a_checkout_the_comparison_is_left_out(tmp_path):
    absent = mock.patch.object(benchmark, "ORACLE", Path("/nowhere/sparse_bayesian.py"))
    with absent, mock.patch.object(benchmark, "measure_memory", return_value=[]):
        _, out, _ = launch(tmp_path, "parts=[sbl]")
    rows = json.loads((tmp_path / "benchmark.json").read_text())["rows"]
    values = values_of(rows, "sbl")
    assert list(values) == ["torchdt", "NumPy"]
    assert values["NumPy"] is None
    assert "left out" in rows[1]["note"]
    assert "left out" in out


def test_ratios_and_peaks_of_the_plain_formulations():
    plain = [Plain(8.0, 100, 90, {1, 2}, {1, 2}), Plain(6.0, 50, 50, {3, 4}, {4, 5})]
    found = {row.quantity: row for row in plain_rows([2.0, 1.0], plain, 0.5, 3)}
    assert found["matrix products / torchdt"].value == 5.0
    assert found["NumPy, outer products"].value == 37.5
    assert found["outer products / torchdt"].value == 25.0
    assert found["iterations of torchdt"].value == 70
    assert (found["steps with identical peaks"].value, found["peaks in common"].value) == (1, 3)
    assert found["peaks in common"].unit == "of 5"


def test_only_high_local_maxima_are_compared():
    power = torch.tensor([0.0, 5.0, 1.0, 0.1, 0.2, 0.1, 1e-3, 4e-3, 0.0, 6e-3])
    assert high_peaks(power, (10,)) == {1, 4, 9}  # of 4e-3 at cell 7: below 1e-3 of 5
    assert high_peaks(power.double(), (10,)) == {1, 4, 9}


def test_points_follow_objects_that_stay_in_the_region():
    coordinates = [Coordinate(name, "m", 0.0, 1000.0, 20.0, -5.0, 5.0, 0.05) for name in "xy"]
    region = Region(coordinates, torch.float64)
    tracker = PointTracker(region, 1.0, PointConfig(particles=10), GaussianPosition(region))
    points = simulate_points(tracker, 0)
    steps = benchmark.WARM_UP + benchmark.TIMED
    assert points.position.shape == (steps, 10, 2)
    assert points.present.all()
    assert region.contains(points.position).all()
    # Of noise of variance 100 the mean of 380 squared second differences is 600, with standard deviation 61;
    # of clutter it is 5e5.
    bend = points.position.diff(n=2, dim=0).square()
    assert 300 < bend[:, : benchmark.OBJECTS].mean() < 1000
    assert bend[:, benchmark.OBJECTS :].mean() > 1e5
    assert not torch.equal(simulate_points(tracker, 1).position, points.position)


def test_the_clock_returns_what_was_asked():
    seconds, result = clock(lambda: time.sleep(0.01) or 7)
    assert seconds >= 0.01
    assert result == 7


def test_what_was_left_out_is_printed_as_such():
    console = Console(record=True, width=100)
    print_benchmark(console, {"cores": 2}, [Measured("sbl", "NumPy", math.nan, "s", "left out: none")])
    text = console.export_text()
    assert all(part in text for part in ("NumPy", " - ", "left out: none", "machine: cores 2"))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("parts", []),
        ("parts", ["sbl", "sbl"]),
        ("parts", ["nowhere"]),
        ("repeats", 0),
        ("steps", 0),
        ("particles", 0),
        ("threads", 0),
        ("device", "nowhere"),
    ],
)
def test_settings_out_of_range(key, value):
    with pytest.raises(InputError, match=rf"key '{key}': found"):
        BenchmarkSettings(**({"parts": ["sbl"]} | {key: value}))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ("steps=6", "key 'steps': found 6, expected at most the 5"),
        ('overrides=["tracker=mp_bp"]', "key 'overrides': found"),
    ],
)
def test_data_and_detector_must_fit(tmp_path, changed, message):
    status, _, err = launch(tmp_path, "parts=[sbl]", changed)
    assert status == 1
    assert message in err
