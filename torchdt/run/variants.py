"""Several settings of the model in one batch: every setting on every sequence."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence

from torchdt.core.errors import InputError, require
from torchdt.filter.direct import DirectTracker
from torchdt.model.model import Model, stack_models


def variant_models(model: Model, variants: Sequence[object]) -> list[Model]:
    """Models that differ from one in numbers.

    Args:
        model: for what a variant does not name.
        variants: mappings from names of the model's numbers to values.

    Raises:
        InputError: where there is none, or naming the entry, such as `variants[1].survival`, that is unknown,
            of another type or out of range.
    """
    require(len(variants) > 0, "variants", "none", "one setting or more")
    models = []
    for index, values in enumerate(variants):
        if not isinstance(values, Mapping):
            raise InputError.of_key(f"variants[{index}]", values, "values by name")
        with _named(index, model):
            models.append(model.with_numbers(values))
    return models


def with_variants(tracker: DirectTracker, models: Sequence[Model], num_sequences: int) -> DirectTracker:
    """The tracker for every model and sequence, as one batch.

    Args:
        tracker: of B sequences.
        models: V of them, which differ from that of the tracker in numbers alone.
        num_sequences: B.

    Returns:
        Tracker of V * B sequences, model by model: for `Recording.repeat(V)`.

    Raises:
        InputError: where `variants[v].driving_variance` is not one number for each coordinate.
    """
    settings = []
    for index, model in enumerate(models):
        with _named(index, model):
            settings.append(model.on(tracker.region))
    return tracker.repeat(len(models), stack_models(settings, num_sequences))


@contextlib.contextmanager
def _named(index: int, model: Model) -> Iterator[None]:
    """Errors of a number name the variant it comes from."""
    try:
        yield
    except InputError as error:
        words = str(error)
        for key in sorted(model.keys(), key=len, reverse=True):
            words = words.replace(f"key '{key}.", f"key 'variants[{index}].")
        if words == str(error):
            words = words.replace("key '", f"key 'variants[{index}].", 1)
        raise InputError(words) from error
