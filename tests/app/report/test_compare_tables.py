import csv
import io
import json

import pytest
from oracles import events
from rich.console import Console

from torchdt.app.report.compare_tables import (
    COLUMNS,
    Comparison,
    print_comparison,
    write_comparison,
    write_events,
    write_gospa_table,
)
from torchdt.app.report.scores import Quality

ROWS = [
    Comparison("weak", tracker="direct", gospa=1.5, gospa_ci=0.25, gospa_by_run=[1.25, 1.75], ahead=0.0),
    Comparison("weak", tracker="mp_bp", gospa=1028.4, steps_per_second=34.56, ahead=0.875, difference=10.5),
    Comparison(
        "full",
        tracker="direct_paper",
        gospa=99.994,
        gospa_ci=99.99,
        localisation=99.99,
        missed=99.996,
        false=99.99,
        gospa_all=99999.0,
        false_per_100=99.99,
        switches=99.99,
        steps_per_second=99.99,
        ahead=-10.0,
    ),
    Comparison("births", tracker="direct", error="OSError: no [bold] file"),
]


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_files(tmp_path):
    write_comparison(tmp_path, ROWS[:1])
    write_comparison(tmp_path, ROWS)  # the files grow by being replaced
    table = rows_of(tmp_path / "compare.csv")
    assert list(table[0])[:3] == ["scenario", "tracker", "error"]
    assert "gospa_by_run" not in table[0]
    assert [(row["scenario"], row["tracker"]) for row in table] == [
        ("weak", "direct"),
        ("weak", "mp_bp"),
        ("full", "direct_paper"),
        ("births", "direct"),
    ]
    assert (table[1]["gospa"], table[1]["ahead"], table[1]["difference"]) == ("1028.4", "0.875", "10.5")
    content = json.loads((tmp_path / "compare.json").read_text())["rows"]
    assert content[0]["gospa_by_run"] == [1.25, 1.75]
    assert (content[3]["error"], content[3]["gospa"]) == ("OSError: no [bold] file", None)
    assert {path.name for path in tmp_path.iterdir()} == {"compare.csv", "compare.json"}


def test_gospa_of_all_trackers(tmp_path, score, times):
    half = score._replace(total=score.total / 2)
    write_gospa_table(tmp_path / "gospa.csv", {"direct": score, "mp_bp": half}, times)
    table = rows_of(tmp_path / "gospa.csv")
    assert (
        ",".join(table[0])
        == "tracker,run,step,time_s,gospa,localisation,missed,false,num_truth,num_estimated"
    )
    found = [(row["tracker"], int(row["run"]), int(row["step"])) for row in table]
    assert found == [(name, b, k) for name in ("direct", "mp_bp") for b in range(2) for k in range(6)]
    assert [float(row["gospa"]) for row in table[6:12]] == [1, 1, 101, 101, 101, 101]
    assert [float(row["gospa"]) for row in table[18:]] == [0.5, 0.5, 50.5, 50.5, 50.5, 50.5]
    assert (table[20]["num_estimated"], table[20]["time_s"]) == ("2", "68.192")


def test_events_are_means_over_runs(tmp_path, score):
    quality = Quality("births", runs=2, gospa=65.0, switches=0.5)
    write_events(tmp_path / "direct", "direct", quality, score, seed=3)
    read = events.read(tmp_path / "direct")
    rows = {tag for tag in read.Tags()["scalars"] if tag.startswith("hparam/")}
    assert set(read.Tags()["scalars"]) - rows == {
        f"gospa/{part}" for part in ("total", "localisation", "missed", "false")
    }
    assert events.hparams(read) == {"scenario": "births", "tracker": "direct", "runs": 2.0, "seed": 3.0}
    # What was not scored leaves its cell empty.
    assert {tag: read.Scalars(tag)[-1].value for tag in rows} == {"hparam/gospa": 65, "hparam/switches": 0.5}
    assert [event.step for event in read.Scalars("gospa/total")] == list(range(6))
    # A ghost in one of the two runs at step 2, a source missed by both from step 3 on.
    assert [event.value for event in read.Scalars("gospa/total")] == [1, 1, 51, 101, 101, 101]
    assert [event.value for event in read.Scalars("gospa/false")] == [0, 0, 50, 0, 0, 0]


@pytest.fixture(scope="module")
def printed():
    console = Console(file=io.StringIO(), width=80)
    print_comparison(console, ROWS)
    return console.file.getvalue()


def test_a_block_for_each_scenario(printed):
    cells = [line.split() for line in printed.splitlines()]
    assert [row for row in cells if row[:1] in (["direct"], ["mp_bp"], ["direct_paper"])] == [
        ["direct", "1.50", "±", "0.25", *"-------", "0%"],
        ["mp_bp", "1028", "±", "-", *"------", "34.56", "88%"],
        ["direct_paper", "99.99", "±", "99.99", "99.99", "100", "99.99", "99999", *["99.99"] * 3, "-1000%"],
        ["direct", "-", "±", "-", *"-------", "-"],
    ]
    assert printed.index("weak") < printed.index("births")
    assert printed.count("that of direct is lower") == 2


def test_every_column_is_a_score(printed):
    """No header is cut short, on a terminal of 80 characters either."""
    assert set(COLUMNS) <= set(Comparison.__dataclass_fields__)
    upper = "all false steps"
    lower = "tracker GOSPA ± 95 % local. missed false steps /100 switches /s ahead"
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    assert lines.count(upper) == lines.count(lower) == 3


def test_failures_are_printed_as_they_are(printed):
    assert printed.splitlines()[-1] == "births, direct failed: OSError: no [bold] file"
