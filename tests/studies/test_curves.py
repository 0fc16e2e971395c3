import pytest
from oracles.scripts import call, load

from studies.curves import Curve, curves_figure, read_curve
from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow


@pytest.fixture
def runs(tmp_path):
    """Two tables of held-out values; steps without one stay empty."""
    for name, rows in (("fast", "0,-3.0,4\n1,,7\n2,-1.0,11\n3,-2.0,15\n"), ("slow", "0,-3.0,2\n1,-1.5,40\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tuning.csv").write_text("step,heldout,passes\n" + rows + "9,,50\n")
    return tmp_path


def test_curve_is_the_best_so_far(runs):
    curve = read_curve(runs / "fast")
    assert curve == Curve([4, 11, 15, 50], [-3.0, -1.0, -1.0, -1.0])
    assert [curve.passes_to(value) for value in (-3.5, -1.5, -1.0, -0.5)] == [4, 11, 11, None]


def test_figure_has_a_line_for_each(runs):
    axes = curves_figure({name: read_curve(runs / name) for name in ("fast", "slow")}).axes[0]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["fast", "slow"]


def test_script(runs):
    figure = runs / "curves.png"
    status, out, _ = call(
        load("tuning_curves"), f"fast={runs / 'fast'}", f"slow={runs / 'slow'}", f"--figure={figure}"
    )
    assert status == 0
    assert figure.stat().st_size > 1000
    row = next(line for line in out.splitlines() if "fast" in line and "-1.0000" in line)
    assert [cell.strip() for cell in row.split("│")[4:6]] == ["11", "11"]


def test_bad_input(runs, tmp_path):
    with pytest.raises(InputError, match=r"found no such file"):
        read_curve(tmp_path / "nowhere")
    (runs / "slow" / "tuning.csv").write_text("step,heldout,passes\n0,,3\n")
    with pytest.raises(InputError, match=r"found no held-out values"):
        read_curve(runs / "slow")
    assert call(load("tuning_curves"), "no-name")[0] == 2
