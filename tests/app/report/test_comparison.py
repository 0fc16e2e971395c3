import matplotlib.colors
import numpy as np
import pytest
import torch

from torchdt.app.report.comparison import gospa_comparison_figure, tick_steps, trajectory_figure
from torchdt.app.report.figures import Axis, method_colour, surface_figure
from torchdt.metrics import Gospa

MINUTES = 60.0 * torch.arange(13, dtype=torch.float64)
"""Of thirteen steps, s."""


@pytest.fixture
def tracks():
    """Thirteen minutes: one source goes 100 m a minute, one stays from minute 4 on, one is never there."""
    minutes = torch.arange(13, dtype=torch.float64)
    moving = torch.stack([4000 - 100 * minutes, torch.full_like(minutes, 58.0)], -1)
    moving[10] = torch.nan
    static = torch.tensor([3000.0, 20.0], dtype=torch.float64).repeat(13, 1)
    static[:4] = torch.nan
    return {"moving": moving, "static": static, "absent": torch.full_like(static, torch.nan)}


def scores(*totals):
    """Runs and steps of which only the total matters."""
    return Gospa(*[torch.tensor(totals, dtype=torch.float64)] * 6)


def save(figure, tmp_path):
    path = tmp_path / "figure.png"
    figure.savefig(path)
    assert path.stat().st_size > 1000


def markers(panel, marker):
    return [line.get_xydata()[0].tolist() for line in panel.lines if line.get_marker() == marker]


def test_trajectory(tmp_path, tracks):
    depths = torch.tensor([94.0, 150.0, 212.0])
    figure = trajectory_figure(tracks, MINUTES, depths)
    (panel,) = figure.axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("Range (km)", "Depth (m)")
    assert panel.yaxis_inverted()
    legend = [text.get_text() for text in panel.get_legend().get_texts()]
    assert legend == ["moving", "static", "absent", "array"]
    drawn = {line.get_label(): line for line in panel.lines}
    np.testing.assert_allclose(drawn["moving"].get_xydata(), tracks["moving"] * torch.tensor([1e-3, 1]))
    np.testing.assert_allclose(drawn["array"].get_xydata(), [[0, 94], [0, 150], [0, 212]])
    assert markers(panel, "o")[:2] == [[4.0, 58.0], [3.0, 20.0]]
    assert markers(panel, ".") == [[3.5, 58.0]]  # absent at minute 10, and the other one stays
    assert [(text.get_text(), text.xy) for text in panel.texts] == [("5", (3.5, 58.0))]
    save(figure, tmp_path)


def test_a_trajectory_is_cut_at_the_seam():
    axes = (Axis("Azimuth (deg)", period=360.0), Axis("Elevation (deg)"))
    track = torch.stack([torch.linspace(150, 270, 13), torch.full((13,), 20.0)], -1)
    (panel,) = trajectory_figure({"one": track}, MINUTES, None, axes).axes
    expected = [*range(150, 180, 10), 180, np.nan, *range(-170, -80, 10)]
    np.testing.assert_allclose(panel.lines[0].get_xdata(), expected, atol=1e-4)


def test_trajectory_without_array_or_sources(tmp_path):
    figure = trajectory_figure({}, MINUTES)
    assert not figure.axes[0].lines
    assert figure.axes[0].get_legend() is None
    save(figure, tmp_path)


def test_ticks_are_the_nearest_steps():
    assert tick_steps(4.096 * torch.arange(292)) == {5: 73, 10: 146, 15: 220}
    assert tick_steps(MINUTES[:11]) == {5: 5, 10: 10}
    assert tick_steps(MINUTES[:5]) == {}
    assert tick_steps(1800 + MINUTES) == {35: 5, 40: 10}
    assert tick_steps(1825 + MINUTES) == {35: 5, 40: 10}


def test_gospa(tmp_path):
    hidden = torch.tensor([False, True, False, True, True])
    methods = {"good": scores([1, 9, 2, 9, 9], [3, 9, 4, 9, 9]), "bad": scores([50] * 5, [70] * 5)}
    figure = gospa_comparison_figure(methods, hidden, 90 + MINUTES[:5], "deg")
    (panel,) = figure.axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("Time (min)", "GOSPA (deg)")
    legend = [text.get_text() for text in panel.get_legend().get_texts()]
    assert legend == ["hidden", "good, mean 2.5", "bad, mean 60.0"]  # hidden steps left out
    good, bad = panel.lines
    np.testing.assert_allclose(good.get_xydata(), [[1.5, 2], [2.5, 9], [3.5, 3], [4.5, 9], [5.5, 9]])
    np.testing.assert_allclose(bad.get_ydata(), 60)
    assert good.get_drawstyle() == "steps-mid"
    spans = [(box.get_x(), box.get_x() + box.get_width()) for box in panel.patches]
    assert spans == [(2.0, 3.0), (4.0, 5.5)]
    assert panel.get_ylim()[0] == 0
    save(figure, tmp_path)


def test_nothing_hidden_is_nothing_shaded():
    (panel,) = gospa_comparison_figure({"a": scores([1, 2])}, torch.tensor([False, False]), MINUTES[:2]).axes
    assert not panel.patches
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["a, mean 1.5"]


def test_a_method_has_one_colour_in_all_figures():
    names = [f"method {index}" for index in range(4)]
    over_time = gospa_comparison_figure({n: scores([1.0]) for n in names}, torch.tensor([False]), MINUTES[:1])
    grid = torch.arange(3), torch.arange(2)
    over_surface = surface_figure(torch.rand(3, 2), grid, {n: torch.zeros(1, 2) for n in names})
    for figure in (over_time, over_surface):
        colours = [matplotlib.colors.to_hex(line.get_color()).upper() for line in figure.axes[0].lines]
        assert colours == [method_colour(index) for index in range(4)]
