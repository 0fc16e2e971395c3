"""Every number of every configuration: one that makes no sense is refused by its name, before any work."""

import math
from collections.abc import Iterator
from dataclasses import is_dataclass

import pytest
from hydra import compose
from omegaconf import AnyNode, Container, DictConfig, FloatNode, IntegerNode, ListConfig, OmegaConf
from omegaconf.errors import ValidationError
from oracles.scripts import configuration, load

from torchdt.core.errors import InputError

pytestmark = pytest.mark.slow

CONFIGURATIONS = {
    "track": ("track",),
    "population": ("track", "scenario=line_array_model"),
    "mp_bp": ("track", "scenario=line_array", "tracker=mp_bp", "data=npz", "data.path=file"),
    "sbl_bp": ("track", "scenario=line_array", "tracker=sbl_bp", "data=sio"),
    "tart": ("tart",),
    "tune": ("tune",),
    "compare": ("compare",),
    "quality": ("quality",),
    "benchmark": ("benchmark",),
    "gradients": ("gradients",),
    "tune_points": ("tune_points",),
}
NEGATIVE = {
    *("seed", "seeds", "train_seeds", "heldout_seeds"),
    *("snr_db", "power_db", "gain_db"),
    *("bow_m", "slope_m_per_km"),
    *(
        "low",
        "high",
        "report_low",
        "report_high",
        "rate_low",
        "rate_high",
        "positions",
        "times_s",
        "truth_depth_m",
    ),
}
"""Numbers of which -1 may be one."""

OTHERS = ("field", "hyperparameters")
"""Groups that fields and quantities of the model check themselves."""


@pytest.fixture(scope="module", params=CONFIGURATIONS)
def config(request):
    name, *overrides = CONFIGURATIONS[request.param]
    load(name)  # whose import brings its schema
    with configuration():
        return compose(name, overrides=overrides)


def numbers(node: Container, place: str) -> Iterator[tuple[Container, object, str]]:
    """Container, key and full name of all numbers, those that are null included."""
    for key in range(len(node)) if isinstance(node, ListConfig) else list(node):
        child, name = node._get_node(key), f"{place}.{key}".lstrip(".")
        if isinstance(child, DictConfig | ListConfig):
            if not child._is_none() and not child._is_missing():
                yield from numbers(child, name)
        elif isinstance(child, IntegerNode | FloatNode) or _is_number(child):
            yield node, key, name


def _is_number(node: object) -> bool:
    value = node._value() if isinstance(node, AnyNode) else None
    return isinstance(value, int | float) and not isinstance(value, bool)


def built_of(config: DictConfig, name: str) -> DictConfig:
    """The least of a configuration whose making checks a number: its group, or all of it.

    Parts of a tracker, such as `tracker.resampler`, are made with all settings.
    """
    group, *rest = name.split(".")
    node = config if group in ("tracker", "conventional") and len(rest) > 1 else config._get_node(group)
    return node if isinstance(node, DictConfig) and is_dataclass(OmegaConf.get_type(node)) else config


def outcome(whole: DictConfig, holder: Container, key: object, value: float) -> str | None:
    """The error that a value makes in the place of a number, or None."""
    before = holder._get_node(key)._value()
    try:
        holder[key] = value
        OmegaConf.to_object(whole)
    except (InputError, ValidationError) as error:
        return str(error)
    finally:
        holder._get_node(key)._set_value(before)
    return None


def test_every_number(config):
    surprises, found = [], [n for n in numbers(config, "") if n[2].partition(".")[0] not in OTHERS]
    assert found
    for holder, key, name in found:
        last = [word for word in name.split(".") if not word.isdigit()][-1]
        for value in (math.nan, math.inf, -math.inf, 1e300, -1e300, -1, 0):
            error = outcome(built_of(config, name), holder, key, value)
            sensible = value == 0 or (value == -1 and last in NEGATIVE)
            if not (sensible if error is None else last in error):
                surprises.append((name, value, error))
    assert surprises == []
