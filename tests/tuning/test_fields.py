import pytest
import torch

from torchdt.field.build import EnvironmentDraw, waveguide
from torchdt.field.waveguide.family import WaveguideFamily
from torchdt.tuning.fields import environment_fields, share_fields

F64 = torch.float64
STATE = torch.tensor([[1500.0, 30.0], [2500.0, 70.0]], dtype=F64)


def solve(draw):
    """A shallow sea with one sound-speed function."""
    return waveguide(
        profile=[[0, 1500], [50, 1495], [100, 1490]],
        layers=[],
        halfspace={"speed": 1800.0, "density": 1.8, "attenuation": 0.1},
        freqs=[60, 90],
        element_depths=[20, 40, 60, 80],
        eofs={"depths": [0, 30, 60], "functions": [[2.0], [1.0], [0.0]]},
        draw=draw,
        dtype=F64,
    )


@pytest.fixture(scope="module")
def start():
    return {
        "eof_coefficients": torch.tensor([0.5], dtype=F64),
        "tilt_deg": torch.tensor(0.3, dtype=F64),
        "water_depth_m": torch.tensor(-0.4, dtype=F64),
    }


@pytest.fixture(scope="module")
def field_of(start):
    return environment_fields(WaveguideFamily(solve, [1.0], 1.0, 1.0), start)


def test_exact_at_the_start(field_of, start):
    expected = solve(EnvironmentDraw((0.5,), 0.3, -0.4))(STATE)
    torch.testing.assert_close(field_of(start)(STATE), expected)
    torch.testing.assert_close(field_of({})(STATE), expected)


@pytest.mark.parametrize("name", ["eof_coefficients", "tilt_deg", "water_depth_m"])
def test_each_value_has_its_place(field_of, start, name):
    """What the named value changes is what the exact solution says, to first order."""
    moved = {name: start[name] + 0.1}
    draw = {key: value.tolist() for key, value in (start | moved).items()}
    exact, before = solve(draw)(STATE), field_of({})(STATE)
    error, change = (field_of(moved)(STATE) - exact).abs().max(), (exact - before).abs().max()
    assert change > 1e-3
    assert error < 0.05 * change


def test_share(field_of):
    share = torch.tensor([0.2, 0.05], dtype=F64, requires_grad=True)
    field = share_fields(field_of, torch.zeros((), dtype=F64))({"mismatch_share": share})
    plain = field_of({})
    ratio = field(STATE).abs().square().sum(-1) / plain(STATE).abs().square().sum(-1)
    torch.testing.assert_close(ratio, (1 - share).expand(2, 2))
    diffuse = field.diffuse(STATE).diagonal(dim1=-2, dim2=-1).real.sum(-1)
    diffuse.sum().backward()
    torch.testing.assert_close(share.grad, plain(STATE).abs().square().sum(-1).sum(0))


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        ({"tilt": 1.0}, "key 'field.draw.tilt': found an unknown key"),
        ({"tilt_deg": "steep"}, "key 'field.draw.tilt_deg': found steep, expected a finite number"),
        ({"water_depth_m": float("nan")}, "key 'field.draw.water_depth_m': found nan"),
        ({"eof_coefficients": 1.0}, "key 'field.draw.eof_coefficients': found 1.0, expected a list"),
        ({"eof_coefficients": [1.0, None]}, "expected a list of finite numbers"),
        ({"eof_coefficients": [1.0, 2.0]}, "key 'field': eofs has shape"),
        ([1.0], "key 'field.draw': found"),
    ],
)
def test_bad_draw(draw, words):
    with pytest.raises(ValueError, match=words.replace("[", r"\[")):
        solve(draw)
