"""Waveguides around an environment, against exact solves of their own."""

import pytest
import torch
from oracles.waveguide import configured

from torchdt.field import NormalModeField
from torchdt.field.build import EnvironmentDraw, waveguide
from torchdt.field.waveguide.environment import combine_eofs
from torchdt.field.waveguide.family import WaveguideFamily

F64 = torch.float64
EOF_DEPTHS = (0, 8, 16, 25, 40, 60, 100, 160)
EOFS = (
    (-0.1, -0.3),
    (-2.3, -1.3),
    (-2.5, 0.5),
    (-0.9, 1.0),
    (-0.3, 0.3),
    (-0.4, 0.2),
    (-0.2, 0.1),
    (0, -0.2),
)
PARAMETERS = {"first EOF": 0, "second EOF": 1, "tilt": 2, "water depth": 3}


@pytest.fixture(scope="module")
def make(swellex, sensors):
    """Families by tones."""

    def make(*freqs: float, max_phase_speed: float = 1750.0) -> WaveguideFamily:
        def solve(draw: EnvironmentDraw) -> NormalModeField:
            delta = combine_eofs(EOF_DEPTHS, EOFS, draw.eof_coefficients)
            depth = swellex.water_depth + draw.water_depth_m
            environment = swellex.perturbed(water_depth=depth, delta_c=delta)
            return NormalModeField(
                environment, freqs, sensors, draw.tilt_deg, max_phase_speed=max_phase_speed, dtype=F64
            )

        return WaveguideFamily(solve, [1.0, 1.5], 0.8, 1.2)

    return make


@pytest.fixture(scope="module")
def states() -> torch.Tensor:
    unit = torch.rand(40, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    return unit * torch.tensor([3000.0, 160.0]) + torch.tensor([1500.0, 20.0])


def squared_correlation(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean over states, per tone."""
    norm = a.abs().square().sum(-1) * b.abs().square().sum(-1)
    return ((a.conj() * b).sum(-1).abs().square() / norm).mean(0)


@pytest.mark.parametrize("theta0", [(0.0, 0.0, 0.0, 0.0), (0.4, -0.3, 1.3, -0.5)])
def test_exact_where_it_was_linearised(make, states, theta0):
    family, theta0 = make(49.0, 283.0), torch.tensor(theta0, dtype=F64)
    found = family.linearise(theta0)(theta0)(states)
    torch.testing.assert_close(found, family.solve(theta0)(states), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", PARAMETERS)
def test_slopes_agree_with_central_differences_of_exact_solves(make, states, name):
    """Around an environment that is tilted and not nominal; phases aligned to the response there."""
    family, tilted = make(49.0, 148.0, 388.0), torch.tensor([0.5, -0.3, 0.9, 0.4], dtype=F64)
    step = torch.zeros(4, dtype=F64)
    step[PARAMETERS[name]] = 0.1
    centre, linear = family.solve(tilted)(states), family.linearise(tilted)

    def slope(fields) -> torch.Tensor:
        rise = fields(tilted + step)(states) - fields(tilted - step)(states)
        return (rise - centre * (centre.conj() * rise).sum(-1, keepdim=True)) / 0.2

    found, expected = slope(linear), slope(family.solve)
    error = torch.linalg.vector_norm(found - expected, dim=(0, 2))
    size = torch.linalg.vector_norm(expected, dim=(0, 2))
    assert (error < 0.04 * size).all(), error / size


@pytest.mark.parametrize("sign", [1, -1])
def test_follows_the_exact_field_for_a_standard_deviation(make, tones, states, sign):
    """All parameters together, in a direction that the nominal field does not survive at 388 Hz."""
    family = make(*tones)
    nominal = torch.zeros(4, dtype=F64)
    theta = sign * family.prior_std * torch.tensor([0.5, -0.5, 0.5, 0.5], dtype=F64)  # one in all
    exact = family.solve(theta)(states)
    assert squared_correlation(family.solve(nominal)(states), exact)[-1] < 0.7
    assert (squared_correlation(family.linearise(nominal)(theta)(states), exact) > 0.97).all()


@pytest.mark.parametrize("name", PARAMETERS)
def test_follows_the_exact_field_along_each_parameter(make, states, name):
    family, nominal = make(49.0, 388.0), torch.zeros(4, dtype=F64)
    theta = torch.zeros(4, dtype=F64)
    theta[PARAMETERS[name]] = family.prior_std[PARAMETERS[name]]
    exact = family.solve(theta)(states)
    near = squared_correlation(family.linearise(nominal)(theta)(states), exact)
    assert (near > 0.97).all()
    assert (near > squared_correlation(family.solve(nominal)(states), exact)).all()


def test_gradient_in_the_parameters(make):
    linear = make(49.0, 148.0).linearise(torch.tensor([0.2, 0.1, 0.5, -0.3], dtype=F64))
    state = torch.tensor([[2345.6, 57.3], [3456.7, 101.2]], dtype=F64)
    theta = torch.tensor([0.4, -0.6, 0.9, 0.8], dtype=F64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: linear(t)(state), (theta,), atol=1e-7)


def test_another_water_depth_has_another_depth_grid(make, states):
    family, nominal = make(388.0), torch.zeros(4, dtype=F64)
    deeper = torch.tensor([0.0, 0.0, 0.0, 1.2], dtype=F64)
    sizes = {len(family.solve(t)._shapes) for t in (nominal, 0.5 * deeper, -0.5 * deeper)}
    assert len(sizes) > 1, "the case of interest"
    near = family.linearise(nominal)(deeper)
    assert float(near.water_depth) == pytest.approx(216.5 + 1.2)
    exact = family.solve(deeper)(states)
    assert squared_correlation(near(states), exact) > 0.97
    assert squared_correlation(family.solve(nominal)(states), exact) < 0.8


def test_a_mode_at_the_edge_may_exist_on_one_side_only(make, states):
    """The one of 64 modes is left out; what it carries is hardly missed."""
    family, theta0 = make(388.0), torch.tensor([0.7, -0.4, 1.3, -0.9], dtype=F64)
    step = torch.tensor([0.5, 0.0, 0.0, 0.0], dtype=F64)
    counts = [family.solve(theta).mode_counts for theta in (theta0 - step, theta0)]
    assert counts == [[63], [64]], "the case of interest"
    linear = family.linearise(theta0)
    for theta in (theta0, theta0 + step, theta0 - step):
        assert squared_correlation(linear(theta)(states), family.solve(theta)(states)) > 0.999


def test_draw_of_parameters(make):
    family = make(49.0)
    draw = family.draw(torch.tensor([0.5, -1.0, 0.25, -0.75], dtype=F64))
    assert draw == EnvironmentDraw((0.5, -1.0), 0.25, -0.75)
    assert family.describe(torch.zeros(4, dtype=F64)) == "nothing"


@pytest.fixture(scope="module")
def whole(tones):
    """A family of all parameters: one EOF, tilt, depth, bow, slope, and gains and phases of 21 sensors."""
    eofs = {"depths": EOF_DEPTHS, "functions": [[row[0]] for row in EOFS]}
    keywords = configured(freqs=(49, 148, 388), eofs=eofs, slope_m_per_km=0.0)

    def solve(draw: EnvironmentDraw) -> NormalModeField:
        return waveguide(**keywords, draw=draw, dtype=F64)

    sensors = {"gain_std_db": [1.0] * 21, "phase_std_deg": [10.0] * 21}
    return WaveguideFamily(solve, [1.0], 1.0, 1.0, bow_std_m=2.0, slope_std_m_per_km=3.0, **sensors)


def departed(family: WaveguideFamily, **values: float) -> torch.Tensor:
    theta = torch.zeros_like(family.prior_std)
    for name, value in values.items():
        theta[family.parts[name]] = value
    return theta


@pytest.mark.parametrize("slope", [0.0, 0.2, -0.2, 5.3, -4.0])
def test_follows_a_slope_from_another(whole, states, slope):
    """Exactly where there is one to go on from, and from a flat bottom for a metre in a kilometre."""
    start = departed(whole, slope_m_per_km=slope)
    free = departed(whole, slope_m_per_km=1.0).bool()
    linear = whole.linearise(start, free)
    for change in (0.1, 0.3, -0.3):
        theta = start + change * free
        exact = whole.solve(theta)(states)
        least = 0.9999 if abs(slope) > 1 else 0.999
        assert (squared_correlation(linear(theta)(states), exact) > least).all()
        assert squared_correlation(whole.solve(start)(states), exact)[-1] < 0.99


@pytest.mark.parametrize("slope", [0.0, 3.0])
def test_gradient_in_all_parameters(whole, slope):
    start = departed(whole, slope_m_per_km=slope)
    linear = whole.linearise(start)
    generator = torch.Generator().manual_seed(0)
    theta = start + 0.2 * torch.randn(len(start), generator=generator, dtype=F64)
    state = torch.tensor([[2345.6, 57.3]], dtype=F64)

    def found(theta: torch.Tensor) -> torch.Tensor:
        return torch.view_as_real(linear(theta)(state)).flatten()

    jacobian = torch.autograd.functional.jacobian(found, theta)
    for j in (0, 1, 2, 3, 4, 5, len(theta) - 1):
        step = torch.zeros_like(theta)
        step[j] = 1e-4
        difference = (found(theta + step) - found(theta - step)) / 2e-4
        torch.testing.assert_close(jacobian[:, j], difference, rtol=1e-4, atol=1e-6)


def test_only_what_is_free_changes(whole, states):
    start = departed(whole, slope_m_per_km=3.0, bow_m=1.0)
    free = departed(whole, bow_m=1.0).bool()
    moved = start + 1.0
    expected = torch.where(free, moved, start)
    found = whole.linearise(start, free)(moved)(states)
    torch.testing.assert_close(found, whole.solve(expected)(states), rtol=0.0, atol=1e-12)
    assert whole.describe(start) == "bow (m) +1.00, slope (m/km) +3.00"
