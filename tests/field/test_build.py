"""The targets of configuration groups: what they pass on, and what they warn of."""

import logging

import pytest
import torch

from torchdt.core.errors import InputError
from torchdt.field.build import line_array, plane_wave, spherical_wave, waveguide

WIDE = [[0.0, 0.0, 0.0], [3.7, 0.0, 0.0], [0.0, 3.7, 0.0]]
PLANE = {"freqs": [50.0], "sensor_positions": WIDE, "wave_speed": 340.0, "coordinates": "bearing"}
SPHERE = {"freqs": [50.0], "sensor_positions": WIDE, "wave_speed": 340.0}
GUIDE = {
    "profile": [[0.0, 1450.0], [100.0, 1550.0]],
    "layers": [],
    "halfspace": {"speed": 1600.0, "density": 1.5, "attenuation": 0.1},
    "max_phase_speed": 1599.0,
}


def test_plane_wave_takes_its_settings():
    state = torch.tensor([30.0], dtype=torch.float64)
    plain = plane_wave(**PLANE, dtype=torch.float64)(state)
    other = plane_wave(**PLANE, sign=-1, normalize=False, dtype=torch.float64)(state)
    torch.testing.assert_close(other, 3**0.5 * plain.conj().resolve_conj())


def test_spherical_wave_takes_its_settings():
    state = torch.tensor([30.0, 2.0, 7.0], dtype=torch.float64)
    plane = spherical_wave(**SPHERE, plane_z=7.0, normalize=False, dtype=torch.float64)(state[:2])
    space = spherical_wave(**SPHERE, num_coordinates=3, normalize=False, dtype=torch.float64)(state)
    torch.testing.assert_close(plane, space)
    assert plane.abs().max() < 0.04  # 1 / 30


@pytest.mark.parametrize(
    ("target", "values", "speed"),
    [(plane_wave, PLANE, 343.1), (spherical_wave, SPHERE, 343.2), (line_array, SPHERE, 343.3)],
)
def test_wide_spacing_is_warned_of(caplog, target, values, speed):
    """Half a wavelength is 3.43 m; other speeds for other targets, since equal warnings come once."""
    line = {"sensor_positions": [0.0, 3.7, 7.4]} if target is line_array else {}
    with caplog.at_level(logging.WARNING):
        target(**values | {"wave_speed": 2.5 * speed} | line)
        assert caplog.text == ""
        target(**values | {"wave_speed": speed} | line)
    assert (
        f"3.7 m apart, more than half the wavelength of the highest tone, {speed / 100:.4g} m" in caplog.text
    )


def test_waveguide_takes_the_mesh():
    def respond(**mesh):
        field = waveguide(**GUIDE, freqs=[300.0], element_depths=[20.0, 70.0], dtype=torch.float64, **mesh)
        return field(torch.tensor([2000.0, 40.0], dtype=torch.float64))

    torch.testing.assert_close(respond(points_per_wavelength=16.0), respond())
    change = torch.linalg.vector_norm(respond(points_per_wavelength=32.0) - respond())
    assert 1e-9 < change < 1e-2


@pytest.mark.parametrize(
    ("freqs", "mesh", "message"),
    [
        ([50.0, 10.0], 16.0, "key 'field': no mode at 10.0 Hz"),
        ([300.0], 2.0, "key 'field': two meshes.*raise points_per_wavelength, now 2.0"),
        ([50.0], 0.0, "key 'field': points_per_wavelength is 0.0"),
        ([50.0], float("inf"), "key 'field': points_per_wavelength is inf"),
        ([50.0], 1e9, "key 'field': points_per_wavelength is 1000000000.0"),
    ],
)
def test_waveguide_without_modes_is_named(freqs, mesh, message):
    with pytest.raises(InputError, match=message):
        waveguide(**GUIDE, freqs=freqs, element_depths=[20.0], points_per_wavelength=mesh)


WATER = {"freqs": [300.0], "element_depths": [20.0, 70.0], "dtype": torch.float64}
FILE = "'Own'\n300\n1\n'CVW'\n0 0 100\n0 1450 /\n100 1550 /\n'A' 0\n100 1600 0 1.5 0.16 /\n"


def test_waveguide_of_a_file_is_that_of_its_figures(tmp_path, monkeypatch):
    """0.1 dB/(km Hz) at 1600 m/s are 0.16 dB/wavelength."""
    (tmp_path / "own.env").write_text(FILE)
    monkeypatch.chdir(tmp_path)
    state = torch.tensor([9000.0, 40.0], dtype=torch.float64)
    halfspace = GUIDE["halfspace"] | {"attenuation": 0.16}
    expected = waveguide(**GUIDE, **WATER)(state)
    for field in (
        waveguide(**WATER, env_file="own.env", max_phase_speed=1599.0),
        waveguide(**GUIDE | {"halfspace": halfspace}, **WATER, attenuation_unit="dB/wavelength"),
        waveguide(**GUIDE, **WATER, attenuation_unit="dB/(m kHz)"),
    ):
        torch.testing.assert_close(field(state), expected)
    other = waveguide(**GUIDE, **WATER, attenuation_unit="dB/wavelength")(state)
    assert torch.linalg.vector_norm(other - expected) > 1e-3


def test_environments_around_that_of_a_file(tmp_path):
    """What calibration draws on."""
    (tmp_path / "own.env").write_text(FILE)
    state = torch.tensor([3000.0, 40.0], dtype=torch.float64)
    eofs = {"depths": [0, 50], "functions": [[2.0], [-3.0]]}
    around = {"eofs": eofs, "draw": {"eof_coefficients": [1.5], "tilt_deg": 0.7, "water_depth_m": -2.0}}
    of_file = waveguide(**WATER, **around, env_file=tmp_path / "own.env", max_phase_speed=1599.0)
    torch.testing.assert_close(of_file(state), waveguide(**GUIDE, **WATER, **around)(state))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            GUIDE | {"env_file": "a.env"},
            "'field.env_file': found a file beside field.profile, field.layers, fie",
        ),
        (
            {"env_file": "a.env", "attenuation_unit": "dB/m"},
            "found a file beside field.attenuation_unit, expe",
        ),
        ({"env_file": "a.env"}, "path 'a.env': found no such file"),
        ({"profile": [[0, 1500], [9, 1500]]}, "'field.layers': found nothing, expected .* or field.env_file"),
        (
            GUIDE | {"attenuation_unit": "dB/m"},
            r"'field.attenuation_unit': found dB/m, expected one of .*dB/\(km",
        ),
    ],
)
def test_waveguide_is_described_once(values, message):
    with pytest.raises(InputError, match=message):
        waveguide(**values, **WATER)
