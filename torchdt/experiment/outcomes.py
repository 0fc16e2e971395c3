"""What trackers made of the scenarios of a suite, and its checkpoint."""

import dataclasses
import os
from collections.abc import Mapping
from typing import NamedTuple

from torch import Tensor

from torchdt.checkpoint import load_checkpoint, not_a_checkpoint, save_checkpoint
from torchdt.metrics import Gospa
from torchdt.report.quality import Quality

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
    try:
        return {
            scenario: {
                tracker: Outcome(Quality(**row["quality"]), Gospa(*row["gospa"]), row["estimates"])
                for tracker, row in by_tracker.items()
            }
            for scenario, by_tracker in content.items()
        }
    except (AttributeError, KeyError, TypeError) as error:
        raise not_a_checkpoint(path, KIND) from error
