"""`tuned.yaml` holds numbers, and is seen to hold nothing else before Hydra takes it for a configuration."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import yaml
from omegaconf import OmegaConf

from torchdt.core.errors import InputError, require

NAME = "tuned"
"""Of the configuration, as in `--config-name=tuned`."""

DEFAULTS = ["track", "_self_"]
PARTS = ("defaults", "model", "tracker", "field", "calibration")


def check_command_line(arguments: Sequence[str]) -> None:
    """Check the `tuned.yaml` that the arguments of a job name, if they name one.

    Raises:
        InputError: where it does not hold what tuning writes.
    """
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--config-name", "-cn")
    parser.add_argument("--config-dir", "-cd")
    parser.add_argument("--config-path", "-cp")
    given, _ = parser.parse_known_args(arguments)
    if given.config_name in (NAME, f"{NAME}.yaml"):
        for folder in (given.config_dir, given.config_path):
            path = Path(folder or "", f"{NAME}.yaml")
            if folder and path.is_file():
                check_tuned(path)


def check_tuned(path: str | os.PathLike[str]) -> None:
    """See that a file holds numbers for the tracker and for the field's departure, as tuning writes them.

    A configuration can call any function by `_target_`, and by Hydra's own settings. One that holds numbers
    alone cannot, wherever it comes from.

    Raises:
        InputError: naming the key that is something else, or where it is no such file.
    """
    try:
        content = OmegaConf.to_container(OmegaConf.load(Path(path)))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError.of_path(path, error, "a configuration of tuned values") from error
    try:
        if not isinstance(content, dict):
            raise InputError.of_key("", content, f"some of {PARTS}")
        for key, value in content.items():
            require(
                key in PARTS, str(key), "an unknown key", f"one of {PARTS}, which are all that tuning writes"
            )
            if key == "defaults":
                require(value == DEFAULTS, "defaults", value, DEFAULTS)
            else:
                _check_numbers(str(key), value)
    except InputError as error:
        raise InputError(f"path '{path}': {error}") from error


def _check_numbers(key: str, value: object) -> None:
    """Refuse all but numbers and truth values, in lists and in mappings whose keys mean nothing to Hydra."""
    if isinstance(value, dict):
        for name, entry in value.items():
            require(not str(name).startswith("_"), f"{key}.{name}", entry, "numbers alone")
            _check_numbers(f"{key}.{name}", entry)
    elif isinstance(value, list):
        for entry in value:
            _check_numbers(key, entry)
    else:
        require(isinstance(value, int | float), key, value, "numbers alone")
