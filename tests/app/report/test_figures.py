import math

import numpy as np
import pytest
import torch

from torchdt.app.report.figures import (
    MAX_LEGEND_LABELS,
    Axis,
    gospa_figure,
    surface_figure,
    tracks_figure,
)


def save(figure, tmp_path):
    path = tmp_path / "figure.png"
    figure.savefig(path)
    assert path.stat().st_size > 1000


def lines(panel):
    return {line.get_label(): line for line in panel.lines}


def legend_texts(legend):
    return [text.get_text() for text in legend.get_texts()]


def test_tracks(tmp_path, history, truth, times):
    figure = tracks_figure(history.select(1), truth[1], times[1])
    distance, depth = figure.axes
    assert distance.get_ylabel() == "Range (km)"
    assert depth.get_ylabel() == "Depth (m)"
    assert depth.get_xlabel() == "Time (min)"
    assert depth.yaxis_inverted()
    assert not distance.yaxis_inverted()
    assert legend_texts(distance.get_legend()) == ["truth", "track 3", "track 12"]
    drawn = lines(distance)["track 3"]
    np.testing.assert_allclose(drawn.get_xdata(), times[1] / 60)
    np.testing.assert_allclose(drawn.get_ydata(), 3.001, rtol=1e-6)
    assert lines(depth)["track 12"].get_ydata().tolist() == [90.0]
    assert drawn.get_color() != lines(distance)["track 12"].get_color()
    assert np.isnan(distance.lines[1].get_ydata()).tolist() == [True] * 3 + [False] * 3
    save(figure, tmp_path)
    # The legend stands beside the data, not on it.
    assert distance.get_legend().get_window_extent().x0 >= distance.get_window_extent().x1 - 1


def test_tracks_without_truth_or_objects(tmp_path, history, times):
    empty = history.select(0)._replace(declared=torch.zeros_like(history.declared[0]))
    figure = tracks_figure(empty, None, times[0])
    assert all(not panel.lines for panel in figure.axes)
    assert figure.axes[0].get_legend() is None
    save(figure, tmp_path)


def test_tracks_of_a_bearing(history, truth, times):
    bearing = history.select(0)._replace(position=history.position[0, ..., :1])
    (panel,) = tracks_figure(bearing, truth[0, ..., :1], times[0], (Axis("Bearing (deg)"),)).axes
    assert panel.get_ylabel() == "Bearing (deg)"


def test_many_labels_do_not_flood_the_legend(tmp_path, history, times):
    labels = torch.arange(1, 19).reshape(6, 3)
    many = history.select(0)._replace(declared=torch.ones(6, 3, dtype=torch.bool), label=labels)
    figure = tracks_figure(many, None, times[0])
    legend = figure.axes[0].get_legend()
    assert len(legend.get_texts()) == MAX_LEGEND_LABELS
    assert legend.get_title().get_text() == f"{18 - MAX_LEGEND_LABELS} more not listed"
    styles = {(line.get_color(), line.get_marker()) for line in figure.axes[0].lines}
    assert len(styles) == 18
    save(figure, tmp_path)


def test_gospa(tmp_path, score, times):
    figure = gospa_figure(score.select(1), times[1])
    (panel,) = figure.axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("Time (min)", "GOSPA (m)")
    expected = ["localisation", "missed", "false", "GOSPA, mean 67.7"]
    assert legend_texts(panel.get_legend()) == expected
    np.testing.assert_allclose(panel.lines[0].get_ydata(), [1, 1, 101, 101, 101, 101])
    assert panel.get_ylim()[0] == 0
    save(figure, tmp_path)


def test_surface(tmp_path):
    grid = torch.linspace(500, 5000, 20), torch.linspace(2, 200, 10)
    surface = -30 * torch.ones(20, 10)
    surface[12, 3] = -3.0
    truth = torch.tensor([[3000.0, 54.0], [math.nan, math.nan]])
    estimates = {"estimate": torch.tensor([[3100.0, 60.0]])}
    figure = surface_figure(surface, grid, estimates, truth, dynamic_range=15.0)
    panel, bar = figure.axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("Range (km)", "Depth (m)")
    assert bar.get_ylabel() == "Power (dB)"
    assert panel.yaxis_inverted()
    assert panel.collections[0].get_clim() == (-18.0, -3.0)
    values = panel.collections[0].get_array()
    assert np.unravel_index(values.argmax(), values.shape) == (3, 12)  # depth runs down the rows
    np.testing.assert_allclose(lines(panel)["truth"].get_xydata(), [[3.0, 54.0]], rtol=1e-6)
    np.testing.assert_allclose(lines(panel)["estimate"].get_xydata(), [[3.1, 60.0]], rtol=1e-6)
    assert legend_texts(figure.legends[0]) == ["truth", "estimate"]
    save(figure, tmp_path)


def test_surface_over_one_coordinate(tmp_path):
    bearing = torch.linspace(-90, 90, 181)
    surface = -bearing.abs() / 10
    estimates = {"estimate": torch.tensor([[20.0]])}
    figure = surface_figure(surface, (bearing,), estimates, axes=(Axis("Bearing (deg)"),))
    (panel,) = figure.axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("Bearing (deg)", "Power (dB)")
    np.testing.assert_allclose(lines(panel)["estimate"].get_xydata(), [[20.0, -2.0]], rtol=1e-6)
    assert legend_texts(figure.legends[0]) == ["estimate"]
    save(figure, tmp_path)


def test_surface_of_wrong_dimension():
    with pytest.raises(ValueError, match="dimensions: found surface 2, grid 1, axes 2, positions 2"):
        surface_figure(torch.zeros(4, 4), (torch.arange(4),), {"estimate": torch.zeros(0, 2)})


def test_sets_of_estimates_are_told_apart(tmp_path):
    grid = torch.linspace(500, 5000, 4), torch.linspace(2, 200, 3)
    estimates = {str(n): torch.full((n, 2), 100.0 * n) for n in range(1, 5)} | {"none": torch.zeros(0, 2)}
    figure = surface_figure(torch.rand(4, 3), grid, estimates, torch.tensor([[3000.0, 54.0]]))
    drawn = lines(figure.axes[0])
    assert legend_texts(figure.legends[0]) == list(drawn) == ["truth", *estimates]
    assert [len(line.get_xdata()) for line in drawn.values()] == [1, 1, 2, 3, 4, 0]
    assert len({(line.get_color(), line.get_marker()) for line in drawn.values()}) == 6
    assert len({line.get_color() for line in drawn.values()}) == 6
    save(figure, tmp_path)


def test_surface_names_all_widths():
    estimates = {"good": torch.zeros(1, 2), "bad": torch.zeros(1, 3)}
    with pytest.raises(ValueError, match="positions 2, positions 3"):
        surface_figure(torch.zeros(4, 4), (torch.arange(4), torch.arange(4)), estimates)


AZIMUTH = Axis("Azimuth (deg)", middle=0.0, period=360.0)


def test_tracks_across_the_seam(history, times):
    """A line is cut between 170 and -170, and what is given on another turn is drawn within the region."""
    bearing = history.select(0)._replace(state=history.state[0, ..., :2])
    truth = torch.tensor([150.0, 170.0, 190.0, 210.0, 230.0, 250.0])[:, None, None]
    (panel,) = tracks_figure(bearing, truth, times[0], (AZIMUTH,)).axes
    line = panel.lines[0]
    np.testing.assert_array_equal(line.get_ydata(), [150, 170, np.nan, -170, -150, -130, -110])
    np.testing.assert_allclose(line.get_xdata()[[0, 1, 3, 4, 5, 6]], times[0] / 60)


def test_positions_over_a_surface_are_within_the_region():
    grid = torch.linspace(-175, 175, 36)
    figure = surface_figure(torch.zeros(36), [grid], {"estimate": torch.tensor([[190.0]])}, None, (AZIMUTH,))
    assert lines(figure.axes[0])["estimate"].get_xdata().tolist() == [-170]
