"""The targets of configuration groups: what they pass on, and what they warn of."""

import logging

import pytest
import torch

from torchdt.field.build import line_array, plane_wave, spherical_wave

WIDE = [[0.0, 0.0, 0.0], [3.7, 0.0, 0.0], [0.0, 3.7, 0.0]]
PLANE = {"freqs": [50.0], "sensor_positions": WIDE, "wave_speed": 340.0, "coordinates": "bearing"}
SPHERE = {"freqs": [50.0], "sensor_positions": WIDE, "wave_speed": 340.0}


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
