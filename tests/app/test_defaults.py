"""Dataclasses and the configuration say the same: no default stands twice with two values."""

import pytest
from hydra import compose
from omegaconf import DictConfig, OmegaConf
from oracles.scripts import configuration, configured, load

JOBS = sorted(configured("*.yaml"))
GROUPS = [
    ("track", "data=wav", "data"),
    ("track", "data=tart", "data"),
    ("track", "logging=default", "logging"),
    ("track", "calibration=environment", "calibration"),
    ("track", "calibration=none", "calibration"),
    ("track", "tracker=direct", "tracker"),
    ("tune", "tuning=gradient", "tuning"),
]
"""Options that stand for no choice of their own, and `calibration=none`, of which only `enabled` is one."""


@pytest.fixture(scope="module", autouse=True)
def _conf():
    for name in JOBS:
        load(name)  # whose import brings its schema
    with configuration():
        yield


def differences(config: DictConfig, defaults: object) -> dict[str, tuple]:
    """What a configuration and a dataclass say of a key, where both say something, and not the same."""
    ours = OmegaConf.to_container(OmegaConf.structured(defaults))
    theirs = {key: _without_target(value) for key, value in OmegaConf.to_container(config).items()}
    return {
        key: (theirs[key], ours[key])
        for key in theirs
        if theirs[key] != ours[key] and not _is_empty(ours[key])
    }


def _without_target(value: object) -> object:
    return {k: v for k, v in value.items() if k != "_target_"} if isinstance(value, dict) else value


def _is_empty(default: object) -> bool:
    return default in ([], {})  # left to the configuration


@pytest.mark.parametrize("name", JOBS)
def test_jobs(name):
    """Their own keys; groups, which may be chosen, come below."""
    config = compose(name)
    groups = {group for group in config if configured(f"{group}/*.yaml")} | {"conventional"}
    found = differences(
        OmegaConf.masked_copy(config, [k for k in config if k not in groups]), OmegaConf.get_type(config)
    )
    assert found == {}


@pytest.mark.parametrize(("name", "choice", "group"), GROUPS)
def test_groups(name, choice, group):
    config = compose(name, overrides=[choice])[group]
    expected = {"enabled": (False, True)} if choice == "calibration=none" else {}
    assert differences(config, OmegaConf.get_type(config)) == expected
