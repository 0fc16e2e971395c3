"""Tuning runs that survive the end of their process."""

import dataclasses
import os
from collections.abc import Mapping

import torch
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.run.checkpoint import load_checkpoint, require_like, save_checkpoint
from torchdt.tuning.state import Record, TuningState

KIND = "tune"

STATE = {
    **dict.fromkeys(("raw", "best", "good", "optimizer"), dict),
    "best_heldout": float | None,
    "stale": int,
    "records": tuple,
    "finished": bool,
}
RECORD = {
    "step": int,
    "values": dict,
    "objective": float | None,
    "gradient_norms": dict,
    "heldout": float | None,
    "skipped": int,
    "passes": int,
}


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
    require_like(path, fields, STATE)
    for record in fields["records"]:
        require_like(path, record, RECORD, "content.records")
    if not fields["records"]:
        raise InputError.of_path(path, "no records", "one for each step; another folder starts anew")
    records = tuple(Record(**record) for record in fields["records"])
    return TuningState(**{**fields, "records": records})


def require_values(path: str | os.PathLike[str], state: TuningState, start: Mapping[str, Tensor]) -> None:
    """Check that the values of a state are those that are tuned.

    Args:
        path: of its checkpoint, for the error.
        state: to go on from.
        start: unconstrained values of the hyperparameters by name.

    Raises:
        InputError: where names, shapes or types differ.
    """
    for name in ("raw", "best") + ("good",) * bool(state.good):
        require_like(path, getattr(state, name), dict(start), f"content.{name}")
    if state.optimizer:
        moments = {
            index: {"step": torch.zeros(()), "exp_avg": value, "exp_avg_sq": value}
            for index, value in enumerate(start.values())
        }
        group = torch.optim.Adam(list(start.values())).state_dict()["param_groups"][0]
        groups = [dict.fromkeys(group, object)]
        require_like(path, state.optimizer, {"state": moments, "param_groups": groups}, "content.optimizer")
        names = list(state.optimizer["param_groups"][0]["params"])
        if names != list(moments):
            expected = f"parameters {list(moments)}; another folder starts anew"
            raise InputError.of_path(path, f"content.optimizer: parameters {names}"[:200], expected)
