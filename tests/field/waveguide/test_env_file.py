"""Environment files give the waveguide that their figures describe, and are refused by file and line."""

import math
from dataclasses import replace

import numpy as np
import pytest

from torchdt.core.errors import InputError
from torchdt.field import HalfSpace, Layer, read_env, solve_modes

TONE = 148.0
DB = 20 * math.log10(math.e)
PEKERIS = """\
'Pekeris waveguide'        ! title
148.0                      ! frequency
1                          ! media
'CVF'                      ! options
500 0.0 100.0              ! mesh points, roughness, depth
  0.0 1500.0 0.0 1.0 /
100.0 1500.0 /
'A' 0.0
100.0 1800.0 0.0 1.7 0.03 /
1400.0 20000.0
"""
LAYERED = """
Water over two layers, frequency and options without quotes
1.48D2 Hz

3
CVW
0, 0.0, 100.0
0.0, 1500.0, , 1.0,, /3
50.0 1490.0 0.0 1.0 0.0 0.0
100.000001 1495.0 / ! within a hundredth of a millimetre
0 0.0 120.0
100.0, 1600., 0.0, 1.5, .5 / layer
110.0 1650 /
120.0 /
12 0.0 150.0
120.0\t1700.0\t0.0\t1.8\t0.2/
150.0 1750.0 /
"A",0.0
/
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="own.env"):
        (tmp_path / name).write_bytes(text.encode("latin-1"))
        return tmp_path / name

    return write


def env_text(environment, options, convert):
    """The file of an environment; `convert` makes its figures of attenuations."""
    rows = [(z, c, 1.0, 0.0) for z, c in environment.profile]
    media, top = [rows], environment.water_depth
    for layer in environment.layers:
        loss = convert(layer.attenuation)
        ends = ((top, layer.speed_top), (layer.bottom, layer.speed_bottom))
        media.append([(z, c, layer.density, loss) for z, c in ends])
        top = layer.bottom
    lines = ["'Own'", repr(TONE), str(len(media)), f"'{options}'"]
    for rows in media:
        lines.append(f"0 0.0 {rows[-1][0]!r}")
        lines += [f"{z!r} {c!r} 0.0 {rho!r} {loss!r} 0.0" for z, c, rho, loss in rows]
    half = environment.halfspace
    return "\n".join(
        [*lines, "'A' 0.0", f"{top!r} {half.speed!r} 0.0 {half.density!r} {convert(half.attenuation)!r} 0"]
    )


def in_unit(environment, unit):
    """The same figures in another unit."""
    layers = tuple(replace(layer, attenuation_unit=unit) for layer in environment.layers)
    return replace(
        environment, layers=layers, halfspace=replace(environment.halfspace, attenuation_unit=unit)
    )


def assert_same_modes(found, expected):
    one, other = (solve_modes(environment, TONE) for environment in (found, expected))
    np.testing.assert_allclose(one.wavenumber, other.wavenumber, rtol=1e-9)
    np.testing.assert_allclose(one.attenuation, other.attenuation, rtol=1e-9)
    np.testing.assert_allclose(one.psi, other.psi, atol=1e-9)


@pytest.mark.parametrize(
    ("letter", "unit", "convert"),
    [
        ("F", "dB/(km Hz)", lambda a: a),
        ("M", "dB/(km Hz)", lambda a: a * TONE / 1000),
        ("N", "dB/(km Hz)", lambda a: a * TONE / 1000 / DB),
        ("W", "dB/wavelength", lambda a: a),
        ("Q", "dB/wavelength", lambda a: math.pi * DB / a),
        ("L", "dB/wavelength", lambda a: a / (2 * math.pi * DB)),
    ],
)
def test_each_unit_gives_the_modes_of_the_figures(write, swellex, letter, unit, convert):
    """Two layers with steep gradients: wavelengths there differ from top to bottom."""
    found = read_env(write(env_text(swellex, f"CV{letter}", convert)))
    assert found.profile == swellex.profile
    assert_same_modes(found, in_unit(swellex, unit))


def test_units_agree_where_the_speed_is_uniform(write, swellex):
    """0.2 dB/(m kHz) at 1572 m/s is 0.3144 dB/wavelength, and the same for the others."""
    layers = (Layer(240.0, 1572.0, 1572.0, 1.76, 0.2), Layer(1040.0, 1881.0, 1881.0, 2.06, 0.06))
    expected = replace(swellex, layers=layers, halfspace=HalfSpace(5200.0, 2.66, 0.02))
    text = env_text(expected, "CVW", {0.2: 0.3144, 0.06: 0.11286, 0.02: 0.104}.get)
    assert_same_modes(read_env(write(text)), expected)


def test_a_pekeris_file(write):
    found = read_env(write(PEKERIS))
    assert found.profile == ((0.0, 1500.0), (100.0, 1500.0))
    assert found.layers == ()
    assert found.halfspace == HalfSpace(1800.0, 1.7, 0.03, "dB/(m kHz)")


def test_values_are_repeated_and_separated_as_in_fortran(write):
    found = read_env(write(LAYERED.replace("\n", "\r\n")))
    assert found.profile == ((0.0, 1500.0), (50.0, 1490.0), (100.000001, 1495.0))
    assert found.layers == (
        Layer(110.0, 1600.0, 1650.0, 1.5, 0.5, "dB/wavelength"),
        Layer(120.0, 1650.0, 1650.0, 1.5, 0.5, "dB/wavelength"),
        Layer(150.0, 1700.0, 1750.0, 1.8, 0.2, "dB/wavelength"),
    )
    assert found.halfspace == HalfSpace(1750.0, 1.8, 0.2, "dB/wavelength")


def test_an_encoding_of_the_title_does_not_matter(write):
    assert read_env(write(PEKERIS.replace("Pekeris", "Pék\xe9ris"))) == read_env(write(PEKERIS, "plain.env"))


def test_no_quality_factor_is_no_loss(write):
    assert read_env(write(PEKERIS.replace("CVF", "CVQ").replace(" 0.03", " 0"))).halfspace.attenuation == 0


def test_squared_slowness_linear_in_depth(write, swellex):
    """Within 0.001 m/s of it at all depths, also where speeds change by a half."""
    found = read_env(write(env_text(swellex, "NVF", lambda a: a)))

    def exact(depth, z, c):
        return np.interp(depth, z, np.array(c) ** -2.0) ** -0.5

    depth = np.linspace(0.0, swellex.water_depth, 20001)
    water = np.interp(depth, *np.array(found.profile).T)
    np.testing.assert_allclose(water, exact(depth, *np.array(swellex.profile).T), rtol=0, atol=1e-3)
    bottoms, lower = np.array([(x.bottom, x.speed_bottom) for x in found.layers]).T
    deep = bottoms > 240.5
    depth = np.linspace(241.0, 1040.0, 20001)
    expected = exact(depth, [240.0, 1040.0], [1881.0, 3245.8])
    np.testing.assert_allclose(np.interp(depth, bottoms[deep], lower[deep]), expected, rtol=0, atol=1e-3)
    assert 10 < len(found.profile) < 200
    assert abs(np.interp(640.0, bottoms[deep], lower[deep]) - 2563.4) > 100  # far from a straight line
    finest = [(z, float(exact(z, *np.array(swellex.profile).T))) for z in np.linspace(0, 216.5, 1733)]
    water = replace(found, profile=finest)
    one, other = (solve_modes(environment, TONE).wavenumber for environment in (found, water))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "line", "found"),
    [
        ("148.0 ", "none  ", 2, "found 'none', expected a frequency in Hz"),
        ("148.0 ", "-1.0  ", 2, "found frequency -1, expected a positive number of Hz"),
        ("1     ", "1.5   ", 3, "found 1.5 media"),
        ("'CVF'", "'SVF'", 4, "found top options 'SVF', expected C or N first"),
        ("'CVF'", "'CAF'", 4, "found top options 'CAF', expected V second"),
        ("'CVF'", "'CVm'", 4, "found top options 'CVm', expected N, F, M, W, Q or L third"),
        ("'CVF'", "'CVWT'", 4, "found top options 'CVWT', expected no fourth letter: the water absorbs"),
        ("'CVF'", "'CVF *'", 4, "expected no altimetry"),
        ("500 0.0 100.0", "500 0.5 100.0", 5, "found roughness 0.5 m, expected 0"),
        ("500 0.0 100.0", "500 0.0 /    ", 5, "found nothing, expected number of mesh points"),
        ("500 0.0 100.0", "500 0.0 -10.0", 5, "found depth -10 m, expected a medium that ends below 0 m"),
        ("  0.0 1500.0", "  5.0 1500.0", 6, "found depth 5 m, expected 0 m, where the medium starts"),
        (" 0.0 1.0 /", " 0.0 1.03 /", 6, "found density 1.03 and attenuation 0, expected 1 and 0"),
        (" 0.0 1.0 /", " 0.0 1.0 .1 /", 6, "found density 1 and attenuation 0.1, expected 1 and 0"),
        (" 0.0 1.0 /", " 0.0 1.0", 6, "found 4 values without '/', expected z cp cs rho alphap alphas"),
        (" 0.0 1.0 /", " 1.0 ! /", 6, "found 3 values without '/'"),
        (" 0.0 1.0 /", " 20.0 1.0 /", 6, "found shear speed 20, expected 0"),
        ("100.0 1500.0 /", "100.0 inf /", 7, "found 'inf', expected z cp cs"),
        ("100.0 1500.0 /", "100.0 -1 /", 7, "found sound speed -1, expected a positive number of m/s"),
        ("100.0 1500.0 /", "101.0 1500.0 /", 7, "found depth 101 m, expected one below 0 m, down to 100 m"),
        ("100.0 1500.0 /", "0.0 1500.0 /", 7, "found depth 0 m, expected one below 0 m"),
        (
            "100.0 1500.0 /",
            "100.0 1500.0 0 1.5 /",
            7,
            "found density 1.5 and attenuation 0, expected 1 and 0",
        ),
        ("'A' 0.0", "'R' 0.0", 8, "found bottom option 'R', expected 'A': a half-space"),
        ("'A' 0.0", "'A*' 0.0", 8, "found bottom option 'A\\*'"),
        ("'A' 0.0", "'A' 0.2", 8, "found roughness 0.2 m, expected 0"),
        ("1800.0 0.0 1.7 0.03", "1800.0 0.0 0 0.03", 9, "found density 0, expected a positive number"),
        ("1800.0 0.0 1.7 0.03", "1800.0 0.0 1.7 -1", 9, "found attenuation -1, expected a number not below"),
        ("1800.0 0.0 1.7 0.03", "1800.0 400 1.7 0.03", 9, "found shear speed 400, expected 0"),
    ],
)
def test_a_fault_is_named_by_file_and_line(write, old, new, line, found):
    assert PEKERIS.count(old) == 1
    with pytest.raises(InputError, match=rf"^path '.*own.env', line {line}: .*{found}"):
        read_env(write(PEKERIS.replace(old, new)))


@pytest.mark.parametrize("end", range(1, 9))
def test_a_file_that_ends_early(write, end):
    lines = PEKERIS.splitlines()[:end]
    with pytest.raises(InputError, match=rf"own.env', line {end}: found the end of the file, expected "):
        read_env(write("\n".join(lines)))


def test_several_densities_in_a_sediment(write):
    text = LAYERED.replace("110.0 1650 /", "110.0 1650 0 1.6 /")
    with pytest.raises(InputError, match=r"found density 1.6 and attenuation 0.5, expected 1.5 and 0.5"):
        read_env(write(text))


def test_no_file(tmp_path):
    with pytest.raises(InputError, match=r"path '.*none.env': found no such file"):
        read_env(tmp_path / "none.env")
    with pytest.raises(InputError, match="found a folder, expected an environment file"):
        read_env(tmp_path)
