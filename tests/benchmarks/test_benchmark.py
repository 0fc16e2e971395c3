import csv
import json
import math
from unittest import mock

import pytest
import torch
from hydra import compose
from omegaconf import OmegaConf
from oracles.scripts import SMALL as TRACKER_SMALL
from oracles.scripts import call, configuration, load, track_settings
from rich.console import Console

from benchmarks import benchmark, memory
from benchmarks.report import Measured, Plain, plain_rows, print_benchmark
from benchmarks.settings import PARTS as PART_NAMES
from benchmarks.settings import BenchmarkSettings, ProblemSettings, ScalingSettings
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow
DATA = '"scenario=line_array","scenario.num_steps=5"'
TRACKER = ",".join(f'"{override}"' for override in TRACKER_SMALL if override.startswith("tracker."))
SMALL = (
    f"overrides=[{DATA}]",
    f"direct=[{TRACKER}]",
    'detector=["tracker.detector.tolerance=1e-3"]',
    "problem={slots: 2, particles: 20, tones: 2, sensors: 6, snapshots: 2, sweeps: 1, batch: 2}",
    "scaling={slots: [1, 2, 3], particles: [9, 18, 27], tones: [1, 2, 3], sensors: [4, 5, 6]}",
    "scaling={batch: [1, 2, 3], steps: [1, 2, 4]}",
    "warm_up=2",
    "batch_steps=3",
    f'run=["logging=quiet",{DATA},{TRACKER}]',
    f"online=[{DATA},{TRACKER}]",
    "online_steps=10",
    "peer_particles=[50]",
    "steps=2",
    "repeats=2",
    "particles=200",
)


def finite(text):
    """What JSON holds of a value in a table."""
    return None if math.isnan(float(text)) else float(text)


def launch(directory, *overrides):
    place = (f"hydra.run.dir={directory}", "hydra/job_logging=none")
    return call(load("benchmark"), *place, *SMALL, *overrides)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    directory = tmp_path_factory.mktemp("benchmark")
    with mock.patch.object(memory, "probe", return_value=(2048, 4096)):
        status, out, err = launch(directory)
    assert status == 0, err
    return out, directory, json.loads((directory / "benchmark.json").read_text())


def test_all_parts_are_measured_unless_told_otherwise():
    with configuration():
        settings = OmegaConf.to_object(compose("benchmark"))
    assert settings.parts == list(benchmark.PARTS) == list(PART_NAMES)
    assert settings == BenchmarkSettings(
        parts=settings.parts, overrides=settings.overrides, online=settings.online
    )
    assert (settings.repeats, settings.particles, settings.device) == (3, 10_000, "cpu")


def test_the_default_data_are_of_the_papers_size():
    with configuration():
        overrides = compose("benchmark").overrides
    track = track_settings("tracker=sbl_bp", *overrides, small=False)
    region, field = benchmark.build_region(track, torch.float32), track.field
    assert track.scenario.name == "matched_20"
    assert region.grid_shape == (200, 100)
    assert (len(field["element_depths"]), len(field["freqs"]), track.scenario.num_snapshots) == (21, 7, 3)


def test_every_number_is_positive_and_finite_or_left_out(outcome):
    for row in outcome[2]["rows"]:
        if row["value"] is None:
            assert row["note"].startswith("left out: ")
        elif not row["quantity"].startswith("exponent"):
            assert math.isfinite(row["value"])
            assert row["value"] > 0


def test_the_settings_reach_the_parts(outcome):
    _, _, content = outcome
    found = {(row["part"], row["quantity"]): row for row in content["rows"]}
    assert found["sbl", "torchdt"]["note"].startswith("float32, grid (70,)")
    peaks = found["sbl", "steps with identical peaks"]
    assert (peaks["value"], peaks["unit"]) == (2, "of 2")
    assert "median of 2 iterations" in found["sbl", "NumPy, outer products"]["note"]
    note = found["points", "torchdt"]["note"]
    assert note.startswith("200 particles")
    assert note.endswith("median of 60 steps")
    assert found["update", "torchdt, batch of 2"]["value"] > 0
    assert "2 objects, 20 particles, 2 tones, 6 sensors" in found["update", "torchdt"]["note"]
    assert found["step", "whole step"]["note"] == "4 slots, 100 particles"
    assert found["step", "one sequence"]["note"] == "3 steps"
    assert ("step", "batch of 2") in found
    assert found["scaling", "sensors = 6"]["note"].startswith(
        "update; 2 slots, 20 particles, 2 tones, 2 snapsh"
    )
    assert "1 batch" in found["scaling", "sensors = 6"]["note"]
    assert found["scaling", "steps = 4"]["note"] == "tracking, 4 slots, 100 particles"
    assert "scenario.num_steps=5" in found["memory", "peak memory of a run"]["note"]
    assert ("memory", "resident after 10 steps") in found
    assert ("peers", "torchdt, 50 particles") in found


def test_what_was_extrapolated_is_printed_as_such(outcome):
    out, _, content = outcome
    notes = [row["note"] for row in content["rows"]]
    assert out.count("EXTRAPOLATED") == sum(note.count("EXTRAPOLATED") for note in notes) >= 4


def test_the_figure_is_written_where_its_parts_ran(outcome, tmp_path):
    assert (outcome[1] / "benchmark.png").stat().st_size > 1000
    launch(tmp_path, "parts=[points]")
    assert (tmp_path / "benchmark.csv").exists()
    assert not (tmp_path / "benchmark.png").exists()


def test_the_files_agree_and_say_what_the_machine_is(outcome):
    _, directory, content = outcome
    with (directory / "benchmark.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [{**row, "value": finite(row["value"])} for row in table] == content["rows"]
    assert (content["machine"]["torch"], content["machine"]["device"]) == (torch.__version__, "cpu")
    assert (directory / "manifest.json").exists()


def test_ratios_and_peaks_of_the_plain_formulations():
    plain = [Plain(8.0, 100, 90, {1, 2}, {1, 2}), Plain(6.0, 50, 50, {3, 4}, {4, 5})]
    found = {row.quantity: row for row in plain_rows([2.0, 1.0], plain, 0.5, 3)}
    assert found["matrix products / torchdt"].value == 5.0
    assert found["NumPy, outer products"].value == 37.5
    assert found["outer products / torchdt"].value == 25.0
    assert found["iterations of torchdt"].value == 70
    assert (found["steps with identical peaks"].value, found["peaks in common"].value) == (1, 3)
    assert found["peaks in common"].unit == "of 5"


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
        ("warm_up", 0),
        ("online_steps", 9),
        ("peer_particles", []),
        ("peer_particles", [0, 5]),
        ("threads", 0),
        ("device", "nowhere"),
    ],
)
def test_settings_out_of_range(key, value):
    with pytest.raises(InputError, match=rf"key '{key}': found"):
        BenchmarkSettings(**({"parts": ["sbl"]} | {key: value}))


@pytest.mark.parametrize("key", ["slots", "particles", "tones", "sensors", "snapshots", "sweeps", "batch"])
def test_problems_out_of_range(key):
    with pytest.raises(InputError, match=rf"key 'problem.{key}': found 0, expected a positive integer"):
        ProblemSettings(**{key: 0})


@pytest.mark.parametrize("sizes", [[], [1, 2], [0, 1, 2], [1, 3, 3], [4, 2, 1]])
@pytest.mark.parametrize("key", ["slots", "particles", "tones", "sensors", "batch", "steps"])
def test_sizes_out_of_range(key, sizes):
    expected = "(three or more rising|a list, each entry a positive integer)"
    with pytest.raises(InputError, match=rf"key 'scaling.{key}': found .*, expected {expected}"):
        ScalingSettings(**{key: sizes})


@pytest.mark.parametrize(
    ("part", "changed", "message"),
    [
        ("sbl", "steps=6", "key 'steps': found 6, expected at most the 5"),
        ("sbl", 'detector=["tracker=mp_bp"]', "key 'detector': found"),
        ("step", "batch_steps=6", "key 'batch_steps': found 6 steps, expected at most the 5"),
        ("step", "warm_up=5", "key 'warm_up': found 6 steps, expected at most the 5"),
        ("step", 'direct=["tracker=mp_bp"]', "key 'direct': found"),
        ("scaling", "scaling.steps=[1,2,6]", "key 'scaling.steps': found 6 steps, expected at most the 5"),
    ],
)
def test_data_and_trackers_must_fit(tmp_path, part, changed, message):
    status, _, err = launch(tmp_path, f"parts=[{part}]", changed)
    assert status == 1
    assert message in err
