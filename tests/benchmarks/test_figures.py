import pytest

from benchmarks.figures import Curve, benchmark_figure, scaling_curves
from benchmarks.report import Measured

CURVES = [
    Measured("scaling", "tones = 2", 1.0, "ms"),
    Measured("scaling", "tones = 4", 2.5, "ms"),
    Measured("scaling", "exponent of tones", 1.32, ""),
    Measured("scaling", "steps = 10", 500.0, "ms"),
    Measured("scaling", "exponent of steps", 0.98, ""),
]
PARTS = [
    Measured("step", "field", 3.0, "ms"),
    Measured("step", "field / whole step", 0.1, "ratio"),
    Measured("step", "whole step", 30.0, "ms"),
]
OTHER = [Measured("sbl", "torchdt", 0.2, "s/step")]


def test_curves_are_read_from_the_rows():
    assert scaling_curves([*OTHER, *CURVES, *PARTS]) == {
        "tones": Curve([2, 4], [1.0, 2.5], 1.32),
        "steps": Curve([10], [500.0], 0.98),
    }


def test_curves_and_bars_are_drawn():
    top, bottom = benchmark_figure([*CURVES, *PARTS]).axes
    assert (top.get_xscale(), top.get_yscale()) == ("log", "log")
    assert [text.get_text() for text in top.get_legend().get_texts()] == ["tones: 1.32", "steps: 0.98"]
    assert top.lines[0].get_xydata().tolist() == [[2.0, 1.0], [4.0, 2.5]]
    assert [bar.get_width() for bar in bottom.patches] == [3.0, 30.0]
    assert [label.get_text() for label in bottom.get_yticklabels()] == ["field", "whole step"]


@pytest.mark.parametrize("rows", [CURVES, PARTS])
def test_one_panel_where_one_part_ran(rows):
    (panel,) = benchmark_figure([*OTHER, *rows]).axes
    assert bool(panel.lines) == (rows is CURVES)
    assert bool(panel.patches) == (rows is PARTS)


def test_nothing_to_draw():
    assert benchmark_figure(OTHER) is None
