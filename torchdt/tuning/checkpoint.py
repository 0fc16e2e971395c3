"""Tuning runs that survive the end of their process."""

import dataclasses
import os
from collections.abc import Mapping

from torchdt.checkpoint import load_checkpoint, not_a_checkpoint, save_checkpoint
from torchdt.tuning.state import Record, TuningState

KIND = "tune"


def save_state(path: str | os.PathLike[str], fingerprint: Mapping[str, object], state: TuningState) -> None:
    """Write a state so that `load_state` gives it back, see `save_checkpoint`."""
    save_checkpoint(path, KIND, fingerprint, dataclasses.asdict(state))


def load_state(path: str | os.PathLike[str], fingerprint: Mapping[str, object]) -> TuningState | None:
    """Read a state; None where there is no file.

    Raises:
        InputError: where the file is not the complete checkpoint of a tuning run, or one with another
            fingerprint.
    """
    fields = load_checkpoint(path, KIND, fingerprint)
    if fields is None:
        return None
    try:
        records = tuple(Record(**record) for record in fields["records"])
        return TuningState(**{**fields, "records": records})
    except (KeyError, TypeError) as error:
        raise not_a_checkpoint(path, KIND) from error
