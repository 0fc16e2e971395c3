"""Directories as jobs leave them, written by hand; those of real jobs are in `experiment/test_collect.py`."""

import csv
import json

import pytest
from omegaconf import OmegaConf

from torchdt.model.parameters import Parameters
from torchdt.report.collect_runs import read_runs


@pytest.fixture
def directory(tmp_path):
    (tmp_path / "metrics.json").write_text(
        json.dumps({"num_runs": 2, "num_steps": 5, "seed": 3, "seconds": 1.5})
    )
    return tmp_path


def test_counts_are_no_metrics(directory):
    (run,) = read_runs(directory)
    assert run.metrics == {"seconds": [1.5]}
    assert run.sequences == 2


def test_groups_and_what_was_set(directory):
    """A preset is not a setting: it stands for those that it makes."""
    choices = {"experiment": "paper", "scenario": "line_array", "hydra/launcher": "basic"}
    task = ["+experiment=paper", "seed=3", "~scenario.sources.first"]
    hydra = {"runtime": {"choices": choices}, "overrides": {"task": task}}
    (directory / ".hydra").mkdir()
    OmegaConf.save({"hydra": hydra}, directory / ".hydra" / "hydra.yaml")
    (run,) = read_runs(directory)
    assert run.settings == {"scenario": "line_array"}
    assert run.chosen == {"experiment", "seed", "scenario.sources.first"}


def test_variants_without_truth(directory):
    """And one without a likelihood."""
    with (directory / "variants.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, [*Parameters._fields, "log_likelihood"])
        table.writeheader()
        table.writerows(
            {"survival": share, "log_likelihood": value} for share, value in ((0.9, 7), (0.8, "nan"))
        )
    first, second = read_runs(directory)
    assert (first.settings["tracker.survival"], second.settings["tracker.survival"]) == (0.9, 0.8)
    assert first.metrics == {"log_likelihood": [7.0]}
    assert second.metrics == {}
    assert (first.sequences, second.sequences) == (1, 1)
