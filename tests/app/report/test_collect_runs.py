"""Directories as jobs leave them, written by hand; those of real jobs are in `experiment/test_collect.py`."""

import csv
import json

import pytest
from omegaconf import OmegaConf

from torchdt.app.report.collect_runs import read_runs
from torchdt.core.errors import InputError
from torchdt.model.model import Model


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
        table = csv.DictWriter(file, [*NAMES, "log_likelihood"])
        table.writeheader()
        table.writerows(
            {"survival": share, "log_likelihood": value} for share, value in ((0.9, 7), (0.8, "nan"))
        )
    first, second = read_runs(directory)
    assert (first.settings["model.survival"], second.settings["model.survival"]) == (0.9, 0.8)
    assert first.metrics == {"log_likelihood": [7.0]}
    assert second.metrics == {}
    assert (first.sequences, second.sequences) == (1, 1)


NAMES = tuple(Model().all_quantities())
HEADER = "run,step,gospa,localisation,missed,false\n"
ROWS = "".join(f"{run},{step},0.5,0.25,0.125,0.125\n" for run in range(2) for step in range(5))
VARIANTS = ",".join([*NAMES, "log_likelihood"]) + "\n"


def test_scores_are_of_each_sequence(directory):
    (directory / "gospa.csv").write_text(HEADER + ROWS)
    (run,) = read_runs(directory)
    assert run.metrics["gospa"] == [0.5, 0.5]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gospa.csv", HEADER + ROWS[:-9], "a row that is cut off or too long"),
        ("gospa.csv", HEADER + ROWS[: 9 * len(ROWS) // 10], "9 rows, expected 5 for each of 2 sequences"),
        ("gospa.csv", HEADER, "0 rows, expected 5 for each of 2 sequences"),
        ("gospa.csv", "", "expected one with the columns run, gospa, localisation, missed, false"),
        ("gospa.csv", ROWS, "expected one with the columns run, gospa, localisation, missed, false"),
        ("gospa.csv", HEADER + ROWS.replace("0.5", "half"), "could not convert string to float: 'half'"),
        ("gospa.csv", b"\xff" + ROWS.encode(), "UnicodeDecodeError"),
        ("variants.csv", VARIANTS, "0 rows for 2 sequences"),
        ("variants.csv", VARIANTS + 3 * ("," * len(NAMES) + "1\n"), "3 rows for 2 sequences"),
        ("variants.csv", "survival\n0.5\n", "expected one with the columns"),
        ("variants.csv", VARIANTS + "{," + "," * (len(NAMES) - 1) + "1\n", "JSONDecodeError"),
        ("metrics.json", "[" * 10**5, "RecursionError"),
        ("metrics.json", '{"a":' * 60 + "1" + "}" * 60, "more than 50 levels"),
        ("metrics.json", '{"a": "\\ud800", "seconds": 1}', "UnicodeEncodeError"),
        ("metrics.json", "[]", "a list, expected a JSON object"),
        ("metrics.json", "null", "a NoneType, expected a JSON object"),
        ("metrics.json", '{"num_runs": "two", "seconds": 1}', "num_runs 'two', expected a positive integer"),
        ("metrics.json", '{"num_runs": 0, "seconds": 1}', "num_runs 0, expected a positive integer"),
        ("metrics.json", '{"seconds": 1' + "0" * 400 + "}", "OverflowError"),
        ("metrics.json", '{"num_runs": 2}', "no results"),
        ("manifest.json", '{"config": 3}', "expected an object 'config'"),
        ("job.json", '{"sweep": 1}', "the job has not ended"),
        (".hydra/hydra.yaml", "hydra: {}", "expected the settings of Hydra"),
        (".hydra/hydra.yaml", "[1, 2", "expected the settings of Hydra"),
        (".hydra/hydra.yaml", "", "expected the settings of Hydra"),
    ],
)
def test_a_bad_file_is_an_error_that_names_it(directory, name, content, words):
    path = directory / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as error:
        read_runs(directory)
    assert str(directory) in str(error.value)
    assert words in str(error.value)


def test_a_folder_in_the_place_of_a_file(directory):
    """It is none."""
    (directory / "gospa.csv").mkdir()
    (run,) = read_runs(directory)
    assert run.metrics == {"seconds": [1.5]}
