import numpy as np
import pytest
import torch

from torchdt.app.figures import axis_of
from torchdt.app.report.belief import Belief, belief_of
from torchdt.app.report.clouds import CLOSE_UPS, MOST_OPAQUE, Frame, cloud_figure
from torchdt.app.report.figures import COLOURS, WAVEGUIDE_AXES, Axis
from torchdt.model.region import Coordinate, Region

RANGE = Coordinate("range", "m", 0, 5000, 50, -3, 3, 1e-3)
DEPTH = Coordinate("depth", "m", 0, 200, 5, -1, 1, 1e-3)


@pytest.fixture
def frame():
    return Frame.of_region(Region([RANGE, DEPTH]), WAVEGUIDE_AXES)


@pytest.fixture
def estimate(history):
    return history.select(1).select(2)


@pytest.fixture
def figure(state, estimate, truth, frame):
    return cloud_figure(belief_of(state, estimate), estimate, truth[1, 3], 2.5, frame)


def cube(estimate, d):
    """One object of d coordinates around 1, 2, ..."""
    centre = torch.cat([torch.arange(1.0, d + 1), torch.zeros(d)])
    points = centre + 0.1 * torch.randn(1, 20, 2 * d, generator=torch.Generator().manual_seed(0))
    region = Region([Coordinate(f"x{i}", "m", 0, 10, 1, -2, 2, 1e-3) for i in range(d)])
    one = type(estimate)(*(field[..., :1] if field.dim() else field for field in estimate))
    belief = Belief(points, torch.full((1, 20), 0.05), torch.ones(1, 1, 1), torch.ones(1, 1, 1))
    return belief, one, Frame.of_region(region, [Axis(f"x{i} (m)") for i in range(d)])


def test_overview_shows_all_objects_in_the_whole_region(figure, state):
    overview = figure.axes[0]
    assert overview.get_xlim() == (0, 5)
    assert overview.get_ylim() == (200, 0)
    clouds = {tuple(np.round(c.get_facecolor()[0, :3], 3)): c.get_offsets() for c in overview.collections}
    blue = tuple(np.round([0x00 / 255, 0x9E / 255, 0x73 / 255], 3))  # the third colour, of label 3
    np.testing.assert_allclose(clouds[blue], state.objects.state[0, :, :2] * torch.tensor([1e-3, 1]))
    assert len(overview.collections) == 3
    assert overview.get_title() == "2.5 s, potential objects: 3"


def test_weight_and_existence_are_opacity(figure, state, estimate):
    weight = state.objects.log_weight[0].exp()
    opacity = MOST_OPAQUE * weight / weight.max()
    overview, close = figure.axes[:2]
    np.testing.assert_allclose(close.collections[0].get_alpha(), opacity, rtol=1e-6)
    np.testing.assert_allclose(
        overview.collections[-1].get_alpha(), opacity * estimate.existence[0], rtol=1e-6
    )


def test_close_ups_of_the_most_probable_objects(figure):
    titles = [panel.get_title() for panel in figure.axes[1:]]
    assert titles == ["label 3, existence 0.988", "label 12, existence 0.988", "no label, existence 0.01"]
    assert figure.axes[1].title.get_color() == COLOURS[2]
    assert figure.axes[3].title.get_color() == "grey"
    low, high = figure.axes[1].get_xlim()
    assert 2.99 < low < 3.0 < 3.002 < high < 3.012  # 3001 m, four standard deviations of 2 m to each side
    crosses = [[line.get_marker() for line in panel.lines].count("x") for panel in figure.axes[1:]]
    assert crosses == [1, 1, 0]  # an object that was never declared has no estimate


def test_truth_is_drawn_where_there_is_any(figure, state, estimate, truth, frame):
    def circles(figure):
        lines = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
        return sorted((float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in lines)

    assert circles(figure) == [(1.5, 20.0), (3.0, 54.0)]
    belief = belief_of(state, estimate)
    assert circles(cloud_figure(belief, estimate, truth[1, 2], 2.5, frame)) == [(3.0, 54.0)]
    assert circles(cloud_figure(belief, estimate, None, 2.5, frame)) == []


@pytest.mark.parametrize(("d", "rows"), [(1, 1), (2, 1), (3, 2)])
def test_panels(estimate, d, rows):
    belief, one, frame = cube(estimate, d)
    figure = cloud_figure(belief, one, torch.full((1, d), 2.0), 2.5, frame)
    panels = np.array(figure.axes).reshape(rows, 1 + CLOSE_UPS)
    upward = {1: ["Rate (per s)"], 2: ["x1 (m)"], 3: ["x1 (m)", "x2 (m)"]}[d]
    for row, label, entry in zip(panels, upward, range(1, 3), strict=False):
        assert [panel.axison for panel in row] == [True, True, False, False]
        assert (row[0].get_xlabel(), row[0].get_ylabel()) == ("x0 (m)", label)
        assert row[0].get_ylim() == ((-2, 2) if d == 1 else (0, 10))
        np.testing.assert_allclose(row[1].collections[0].get_offsets(), belief.particles[0][:, [0, entry]])
    (line,) = [line for line in panels[0, 0].lines if line.get_marker() != "x"]
    assert line.get_marker() == ("None" if d == 1 else "o")  # a true rate is not known


def test_of_many_particles_some_are_drawn(estimate):
    belief, one, frame = cube(estimate, 2)
    many = belief._replace(
        particles=belief.particles.repeat(1, 60, 1), weight=torch.full((1, 1200), 1 / 1200)
    )
    drawn = cloud_figure(many, one, None, 2.5, frame).axes[1].collections[0].get_offsets()
    np.testing.assert_allclose(drawn, many.particles[0, ::3, :2])


def test_a_cloud_may_be_one_point(estimate):
    belief, one, frame = cube(estimate, 2)
    point = belief._replace(particles=belief.particles[:, :1].expand(1, 20, 4))
    low, high = cloud_figure(point, one, None, 2.5, frame).axes[1].get_xlim()
    assert low < point.particles[0, 0, 0] < high
    assert high - low > 1e-6  # wide enough to be labelled


def test_nothing_there(state, estimate, frame):
    nothing = estimate._replace(existence=torch.zeros(3))
    figure = cloud_figure(belief_of(state, estimate), nothing, None, 2.5, frame)
    assert figure.axes[0].get_title() == "2.5 s, potential objects: 0"
    assert [panel.axison for panel in figure.axes] == [True, False, False, False]


def test_a_cloud_across_the_seam(estimate):
    """Its close-up is whole, with the true position beside it; the overview has it on both sides."""
    azimuth = Coordinate("azimuth", "deg", -180, 180, 5, -2, 2, 1e-3, 360)
    one = type(estimate)(*(field[..., :1] if field.dim() else field for field in estimate))
    points = torch.tensor([[[178.0, 0.5], [179.0, 0.0], [181.0, 0.0], [182.0, -0.5]]])
    belief = Belief(points, torch.full((1, 4), 0.25), torch.ones(1, 1, 1), torch.ones(1, 1, 1))
    frame = Frame.of_region(Region([azimuth]), [axis_of(azimuth)])
    overview, close = cloud_figure(belief, one, torch.tensor([[-179.5]]), 0.0, frame).axes[:2]
    assert overview.collections[0].get_offsets()[:, 0].tolist() == [178, 179, -179, -178]
    assert close.collections[0].get_offsets()[:, 0].tolist() == [178, 179, 181, 182]
    drawn = [line.get_xdata()[0] for panel in (overview, close) for line in panel.lines]
    assert {-179.5, 180.5} <= set(drawn)
