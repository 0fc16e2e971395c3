"""The waveguide that a configuration describes, in figures or by a file."""

from collections.abc import Mapping, Sequence

from torchdt.core.errors import InputError, require
from torchdt.field.waveguide.env_file import read_env
from torchdt.field.waveguide.environment import ATTENUATION_UNITS, Environment, HalfSpace, Layer


def configured_environment(
    profile: Sequence[Sequence[float]] | None,
    layers: Sequence[Mapping[str, float]] | None,
    halfspace: Mapping[str, float] | None,
    attenuation_unit: str | None,
    env_file: str | None,
) -> Environment:
    """The environment of `torchdt.field.build.waveguide`, where these keywords are described.

    Raises:
        InputError: where there are both a file and figures, or neither, or the unit is unknown; see also
            `read_env`.
        ValueError, TypeError: where the figures make no sense, see `Environment`.
    """
    figures = {"profile": profile, "layers": layers, "halfspace": halfspace}
    if env_file is not None:
        given = {**figures, "attenuation_unit": attenuation_unit}
        beside = ", ".join(f"field.{name}" for name, value in given.items() if value is not None)
        require(
            not beside, "field.env_file", f"a file beside {beside}", "one or the other; null takes one away"
        )
        return read_env(env_file)
    if profile is None or layers is None or halfspace is None:
        missing = next(name for name, value in figures.items() if value is None)
        raise InputError.of_key(f"field.{missing}", "nothing", "figures of the waveguide, or field.env_file")
    unit = attenuation_unit or ATTENUATION_UNITS[0]
    require(unit in ATTENUATION_UNITS, "field.attenuation_unit", unit, f"one of {ATTENUATION_UNITS}")
    return Environment(
        tuple((float(z), float(c)) for z, c in profile),
        tuple(Layer(**layer, attenuation_unit=unit) for layer in layers),
        HalfSpace(**halfspace, attenuation_unit=unit),
    )
