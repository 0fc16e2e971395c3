import math

import pytest
import torch
from oracles.line_array import Silent
from oracles.line_array import make_field as make_line
from oracles.waveguide import make_field
from scipy.stats import chi2

from torchdt.core.errors import InputError
from torchdt.field.build import EnvironmentDraw
from torchdt.simulation.mismatch import MismatchSettings, draw_environment, with_array_errors

TARGET = {"eofs": {"functions": [[0.0] * 4]}}


def generator(seed: int = 5) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize(
    ("settings", "key", "found", "expected"),
    [
        ({"eof_scale": -1.0}, "eof_scale", -1.0, "a number from 0 up"),
        ({"tilt_deg": [2.0, 1.0]}, "tilt_deg", [2.0, 1.0], "[smallest, largest], both from 0 up"),
        ({"water_depth_m": [1.0]}, "water_depth_m", [1.0], "[smallest, largest], both from 0 up"),
        ({"gain_db": -1.0}, "gain_db", -1.0, "a number from 0 up"),
        ({"bow_m": math.inf}, "bow_m", math.inf, "a finite number"),
        ({"tilt_deg": [-1.0, 1.0]}, "tilt_deg", [-1.0, 1.0], "a list, each entry a number from 0 up"),
    ],
)
def test_bad_settings(settings, key, found, expected):
    with pytest.raises(InputError) as caught:
        MismatchSettings(**settings)
    assert str(caught.value) == f"key 'scenario.mismatch.{key}': found {found}, expected {expected}"


@pytest.mark.parametrize(
    ("settings", "matched"),
    [
        ({}, True),
        ({"eof_scale": 1.0}, False),
        ({"tilt_deg": [0.0, 1.0]}, False),
        ({"water_depth_m": [0.0, 1.0]}, False),
    ],
)
def test_whether_environments_match(settings, matched):
    assert MismatchSettings(**settings).matched == matched


def test_an_environment_and_its_array():
    """The numbers of a seed stay what they are; errors of the array are drawn after them."""
    stream = generator()
    mismatch = MismatchSettings(1.0, [0.5, 1.0], [0.5, 1.0], gain_db=1.5)
    draw = draw_environment(mismatch, TARGET, stream)
    eofs = (-0.48678075071242677, -0.6038215878840039, -0.5580962308236769, 0.6675243015344896)
    assert draw == EnvironmentDraw(eofs, -0.6330585693886361, -0.7896488557190997)
    before, line = stream.get_state(), make_line()
    assert with_array_errors(line, MismatchSettings(), stream) is line
    assert torch.equal(stream.get_state(), before)
    with_array_errors(line, mismatch, stream)
    assert not torch.equal(stream.get_state(), before)


def test_a_field_without_environment():
    for vary in (lambda m: draw_environment(m, {}, generator()), lambda m: m.shaped({})):
        with pytest.raises(
            InputError, match=r"'scenario.mismatch': .* this field has no environment to vary"
        ):
            vary(MismatchSettings(bow_m=1.0))
    assert MismatchSettings().shaped({}) == {}


def test_what_differs_in_all_runs_adds_to_the_configuration():
    told = TARGET | {"bow_m": 0.5}
    shaped = MismatchSettings(bow_m=2.0, slope_m_per_km=5.0).shaped(told)
    assert shaped == TARGET | {"bow_m": 2.5, "slope_m_per_km": 5.0}


def test_gains_and_phases_of_sensors():
    """Standard deviations of as many sensors as many arrays have, two-sided, false alarm 1e-6."""
    line, state = make_line(), torch.tensor([[12.0], [-40.0]], dtype=torch.float64)
    stream, mismatch = generator(), MismatchSettings(gain_db=1.5, phase_deg=12.0)
    ratios = [with_array_errors(line, mismatch, stream)(state) / line(state) for _ in range(50)]
    for ratio in ratios:
        torch.testing.assert_close(ratio, ratio[:1, :1].expand_as(ratio))  # of all states and tones alike
    gain = torch.stack([ratio[0, 0] for ratio in ratios])
    for values, std in ((20 * gain.abs().log10(), 1.5), (gain.angle().rad2deg(), 12.0)):
        spread = values.square().sum().item() / std**2
        assert chi2.ppf(5e-7, values.numel()) < spread < chi2.ppf(1 - 5e-7, values.numel())


def test_noise_from_the_surface_comes_through_the_same_sensors():
    field, state = make_field(torch.float64), torch.tensor([[2800.0, 30.0]], dtype=torch.float64)
    uneven = with_array_errors(field, MismatchSettings(gain_db=3.0, phase_deg=30.0), generator())
    gain = (uneven(state) / field(state))[0, 0]
    expected = torch.diag(gain) @ field.incoherent(state) @ torch.diag(gain).mH
    torch.testing.assert_close(uneven.incoherent(state), expected)
    silent = with_array_errors(Silent(make_line()), MismatchSettings(gain_db=1.0), generator())
    assert silent.incoherent(state) is None
