import csv
import math

from rich.console import Console

from torchdt.app.report.collect import Row, interval_figure, print_rows, write_rows


def row(mean, interval=0.5, **setting):
    return Row(setting, 3, {"gospa": mean, "seconds": 1.0}, {"gospa": interval, "seconds": math.nan})


ROWS = [row(4.0, p=300, kind="a"), row(2.0, p=100, kind="a"), row(3.0, p=100, kind="b", interval=math.nan)]


def lines(figure):
    (axes,) = figure.axes
    return axes, [container.lines[0].get_xydata().tolist() for container in axes.containers]


def test_table():
    console = Console(record=True, width=100)
    print_rows(console, ROWS, ["gospa", "seconds"])
    text = console.export_text()
    for words in ("p", "kind", "runs", "4 ± 0.5", "300"):
        assert words in text
    assert "seconds" in text
    assert "nan" not in text


def test_a_metric_that_a_row_lacks():
    console = Console(record=True, width=100)
    print_rows(console, [row(4.0, p=1), row(math.nan, p=2, interval=math.nan)], ["gospa"])
    assert [line.split("│")[3].strip(" │") for line in console.export_text().splitlines()[3:5]] == [
        "4 ± 0.5",
        "-",
    ]


def test_file(tmp_path):
    write_rows(tmp_path / "runs.csv", [row(4.0, depth=[1, 2], name="a b"), row(5.0, depth=None, name="c")])
    with (tmp_path / "runs.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    assert first == {
        "depth": "[1, 2]",
        "name": "a b",
        "runs": "3",
        "gospa": "4.0",
        "gospa_ci": "0.5",
        "seconds": "1.0",
        "seconds_ci": "nan",
    }
    assert second["depth"] == "null"


def test_a_number_is_an_axis_with_a_curve_for_each_of_the_rest():
    axes, curves = lines(interval_figure(ROWS, "gospa"))
    assert curves == [[[100, 2], [300, 4]], [[100, 3]]]
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_xscale()) == ("p", "gospa", "linear")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["kind=a", "kind=b"]
    bars = axes.containers[0].lines[2][0].get_segments()
    assert [bar[:, 1].tolist() for bar in bars] == [[1.5, 2.5], [3.5, 4.5]]
    assert len({container.lines[0].get_color() for container in axes.containers}) == 2


def test_wide_ranges_are_logarithmic():
    axes, _ = lines(interval_figure([row(1.0, p=1e-3), row(2.0, p=1.0)], "gospa"))
    assert axes.get_xscale() == "log"
    assert axes.get_legend() is None


def test_zero_has_no_logarithm():
    axes, _ = lines(interval_figure([row(1.0, p=0), row(2.0, p=1)], "gospa"))
    assert axes.get_xscale() == "linear"


def test_otherwise_each_row_has_a_place():
    rows = [row(1.0, p=1, q=5, on=True), row(2.0, p=2, q=6, on=False)]
    axes, curves = lines(interval_figure(rows, "gospa"))
    assert curves == [[[0, 1], [1, 2]]]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["p=1\nq=5\non=true", "p=2\nq=6\non=false"]


def test_yes_and_no_are_no_numbers():
    axes, _ = lines(interval_figure([row(1.0, on=True), row(2.0, on=False)], "gospa"))
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["on=true", "on=false"]


def test_nothing_differs():
    axes, curves = lines(interval_figure([row(1.0)], "gospa"))
    assert curves == [[[0, 1]]]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["all runs"]
