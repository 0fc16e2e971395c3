"""What trackers made of the scenarios of a suite, and its checkpoint."""

import dataclasses
import os
from collections.abc import Mapping
from typing import Any, NamedTuple, get_origin

from torch import Tensor

from torchdt.app.report.scores import Quality
from torchdt.core.errors import InputError
from torchdt.metrics import Gospa
from torchdt.run.checkpoint import load_checkpoint, require_like, save_checkpoint

KIND = "compare"


class Outcome(NamedTuple):
    """What one tracker made of a scenario.

    Attributes:
        quality: scores of all runs.
        gospa: `(B, K)`.
        estimates: `(N, d)` declared positions of the first run at the step shown over the surface.
    """

    quality: Quality
    gospa: Gospa
    estimates: Tensor


Outcomes = dict[str, dict[str, Outcome]]
"""By scenario and tracker."""


def save_outcomes(
    path: str | os.PathLike[str], fingerprint: Mapping[str, object], outcomes: Outcomes
) -> None:
    """Write all outcomes so that `load_outcomes` gives them back, see `save_checkpoint`."""
    content = {
        scenario: {
            tracker: {
                "quality": dataclasses.asdict(outcome.quality),
                "gospa": tuple(outcome.gospa),
                "estimates": outcome.estimates,
            }
            for tracker, outcome in by_tracker.items()
        }
        for scenario, by_tracker in outcomes.items()
    }
    save_checkpoint(path, KIND, fingerprint, content)


def load_outcomes(path: str | os.PathLike[str], fingerprint: Mapping[str, object]) -> Outcomes:
    """Outcomes of the rows that are done; none where there is no file.

    Raises:
        InputError: where the file is not the complete checkpoint of a comparison, or one with another
            fingerprint.
    """
    content = load_checkpoint(path, KIND, fingerprint) or {}
    outcomes: Outcomes = {}
    for scenario, by_tracker in content.items():
        require_like(path, by_tracker, dict, f"content.{scenario}")
        outcomes[scenario] = {
            tracker: _outcome(path, row, f"content.{scenario}.{tracker}")
            for tracker, row in by_tracker.items()
        }
    return outcomes


def _outcome(path: str | os.PathLike[str], row: Any, place: str) -> Outcome:
    require_like(path, row, {"quality": dict, "gospa": tuple, "estimates": Tensor}, place)
    quality = {field.name: get_origin(field.type) or field.type for field in dataclasses.fields(Quality)}
    require_like(path, row["quality"], quality, f"{place}.quality")
    require_like(path, row["gospa"], (Tensor,) * len(Gospa._fields), f"{place}.gospa")
    total, estimates = row["gospa"][0], row["estimates"]
    shapes = {part.shape for part in row["gospa"]}
    if len(shapes) != 1 or total.ndim != 2 or len(total) != row["quality"]["runs"] or estimates.ndim != 2:
        found = f"{place}: tensors {[tuple(part.shape) for part in (*row['gospa'], estimates)]}"
        expected = "scores (runs, steps) and estimates (objects, coordinates)"
        raise InputError.of_path(path, found, f"{expected}; another folder starts anew")
    return Outcome(Quality(**row["quality"]), Gospa(*row["gospa"]), estimates)
