"""Several settings of the model in one batch: every setting on every sequence."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from torchdt.core.errors import InputError, require
from torchdt.filter.config import TrackerConfig
from torchdt.filter.direct import DirectTracker
from torchdt.model.parameters import Parameters, default_parameters, stack_parameters


def variant_configs(config: TrackerConfig, variants: Sequence[object]) -> list[TrackerConfig]:
    """Configurations that differ from one in numbers of the model.

    Args:
        config: for what a variant does not name.
        variants: mappings from names in `Parameters` to values as in `TrackerConfig`.

    Raises:
        InputError: where there is none, or naming the entry, such as `variants[1].survival`, that is unknown,
            of another type or out of range.
    """
    require(len(variants) > 0, "variants", "none", "one setting or more")
    configs = []
    for index, values in enumerate(variants):
        key = f"variants[{index}]"
        if not isinstance(values, Mapping):
            raise InputError.of_key(key, values, "values by name")
        for name, value in values.items():
            require(
                name in Parameters._fields,
                f"{key}.{name}",
                "an unknown key",
                f"one of {sorted(Parameters._fields)}",
            )
            vector = name == "driving_variance"
            expected = "a list of numbers or null" if vector else "a number"
            require((_is_vector if vector else _is_number)(value), f"{key}.{name}", value, expected)
        with _named(index):
            configs.append(replace(config, **values))
    return configs


def with_variants(
    tracker: DirectTracker, configs: Sequence[TrackerConfig], num_sequences: int
) -> DirectTracker:
    """The tracker for every configuration and sequence, as one batch.

    Args:
        tracker: of B sequences.
        configs: V of them, which differ from that of the tracker in numbers of the model alone.
        num_sequences: B.

    Returns:
        Tracker of V * B sequences, configuration by configuration: for `Recording.repeat(V)`.

    Raises:
        InputError: where `variants[v].driving_variance` is not one number for each coordinate.
    """
    settings = []
    for index, config in enumerate(configs):
        with _named(index):
            settings.append(default_parameters(config, tracker.region))
    parameters = stack_parameters(settings, num_sequences)
    return tracker.repeat(len(configs), parameters)


@contextlib.contextmanager
def _named(index: int) -> Iterator[None]:
    """Errors of a configuration name the variant it comes from."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace("'tracker.", f"'variants[{index}].")) from error


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_vector(value: object) -> bool:
    return value is None or (isinstance(value, list | tuple) and all(map(_is_number, value)))
