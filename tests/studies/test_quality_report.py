import csv
import io
import json

import pytest
from rich.console import Console

from studies.quality import TABLES, print_rows, write_rows
from torchdt.app.report.scores import Quality

ROWS = [
    Quality("weak", runs=2, gospa=12.3456, gospa_ci=0.5, switches=1.5, seconds=8, gospa_by_run=[12.0, 12.6]),
    Quality("nowhere", error="OSError: no [bold] file"),
]


def test_files(tmp_path):
    write_rows(tmp_path, ROWS[:1])
    write_rows(tmp_path, ROWS)  # the files grow by being replaced
    with (tmp_path / "quality.csv").open(newline="") as file:
        weak, nowhere = csv.DictReader(file)
    assert (weak["scenario"], weak["gospa"], weak["error"]) == ("weak", "12.3456", "")
    assert (nowhere["gospa"], nowhere["error"]) == ("nan", "OSError: no [bold] file")
    assert "gospa_by_run" not in weak
    weak, nowhere = json.loads((tmp_path / "quality.json").read_text())["scenarios"]
    assert weak["gospa_by_run"] == [12.0, 12.6]
    assert nowhere["gospa"] is None
    assert {path.name for path in tmp_path.iterdir()} == {"quality.csv", "quality.json"}


@pytest.fixture(scope="module")
def printed():
    console = Console(file=io.StringIO(), width=120)
    print_rows(console, ROWS)
    return console.file.getvalue()


def test_tables(printed):
    cells = [line.strip("│ ").split() for line in printed.splitlines() if line.startswith("│")]
    weak = [line[2::2] for line in cells if line[0] == "weak"]
    assert weak[0] == ["12.3", "0.5", "-", "-", "-", "-", "-"]
    assert weak[1] == ["-", "1.5", "-", "-", "-"]
    assert weak[2] == ["2", "-", "-", "8"]
    for title, columns in TABLES.items():
        assert title in printed
        assert all(name in Quality.__dataclass_fields__ for name in columns)


def test_failures_are_printed_as_they_are(printed):
    assert printed.splitlines()[-1] == "nowhere failed: OSError: no [bold] file"
