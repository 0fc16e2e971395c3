"""What the constants of the filter are worth: `python experiments/constants.py --help`.

Tracks the same recordings with one constant at a time at a smaller and at a larger value. Where little
changes, quality does not hang on it. Scores are of all steps.
"""

import argparse
import contextlib
from collections.abc import Iterator
from unittest.mock import patch

import torch
from hydra import initialize_config_module
from rich.table import Table

from torchdt.app.build import build_recording, build_tracker
from torchdt.app.report.console import plain_console
from torchdt.app.score import score_history
from torchdt.app.settings import TrackSettings
from torchdt.app.suite import compose_track
from torchdt.model import prior
from torchdt.run.track import track

FEW = ((0.05, None), (0.15, -1), (0.7, 0), (0.1, 1))
MANY = ((0.3, None), (0.25, -1), (0.25, 0), (0.2, 1))
"""Shares of the tones that are silent, below, at and above their level: fewer and more than are assumed."""

CONSTANTS = {
    "covariance of a fitted proposal over that of its target": ("core.importance.INFLATION", 1.5, 4.0),
    "least probability of existence and absence drawn": ("filter.bp.configurations.DOUBT", 1e-3, 0.05),
    "particles behind a predicted moment": ("filter.direct.MOMENT_PARTICLES", 125, 1000),
    "spread of an unknown noise level": ("filter.proposal.search.UNSETTLED", 0.05, 1.0),
    "likelihood outside a box of a new object": ("filter.proposal.neighbourhood.OUTER", 1e-3, 0.1),
    "margin of a mixture over one Gaussian": ("core.partition.MARGIN", 0.03, 0.3),
    "cells tested exactly": ("filter.proposal.strongest.PROMISING", 8, 128),
    "eigenvalues that count as one": ("filter.proposal.cells.BULK", 1.001, 1.05),
    "drift of a node of the intensity, cells a step": ("filter.intensity.grid.ENOUGH", 0.1, 0.5),
    "states by which its nodes are laid": ("filter.intensity.grid.SAMPLES", 1024, 16384),
    "tones around a level of it": ("filter.intensity.settings.AROUND", FEW, MANY),
    "most that a tone adds to it": ("filter.intensity.levels.CEILING", 15.0, 60.0),
    "most that a step adds to its evidence": ("filter.intensity.intensity.CEILING", 30.0, 80.0),
    "largest entry of it": ("filter.intensity.intensity.MOST", 1e2, 1e6),
}
"""By what they are: where, a smaller and a larger value."""

LIMITS = {"limit of powers, of noise": (0.5, 2.0)}
"""Factors of the limits that the priors take from the data."""


@contextlib.contextmanager
def scaled_limits(factor: float) -> Iterator[None]:
    """Limits of the priors that are larger by a factor."""
    original = prior.data_priors
    with patch(
        "torchdt.data.prepare.data_priors",
        lambda measurement: prior.Priors(*(factor * t for t in original(measurement))),
    ):
        yield


def evaluate(settings: TrackSettings) -> tuple[float, float]:
    """Mean GOSPA and log-likelihood per step."""
    recording = build_recording(settings)
    seeds = list(range(settings.seed, settings.seed + recording.batch_size))
    history = track(recording, build_tracker(settings, recording), seeds)
    score = score_history(history, recording, settings)
    assert score is not None
    return score.total.mean().item(), history.log_evidence.double().mean().item()


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenarios", nargs="+", default=["births", "close_equal"])
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("overrides", nargs="*", default=["scenario.num_steps=100", "calibration=none"])
    given = parser.parse_args()
    torch.set_num_threads(1)
    for scenario in given.scenarios:
        with initialize_config_module("torchdt.conf", version_base="1.3"):
            settings = compose_track(scenario, given.overrides, 0, given.runs)
        table = Table("constant", "value", "GOSPA", "log-likelihood per step", title=scenario)
        changes: list[tuple[str, object, contextlib.AbstractContextManager[object]]] = [
            ("as it is", "", contextlib.nullcontext())
        ]
        for words, (place, *values) in CONSTANTS.items():
            changes += [(words, value, patch(f"torchdt.{place}", value)) for value in values]
        for words, factors in LIMITS.items():
            changes += [(words, f"x {factor:g}", scaled_limits(factor)) for factor in factors]
        for words, value, change in changes:
            with change:
                gospa, likelihood = evaluate(settings)
            shown = {FEW: "fewer", MANY: "more"}.get(value, value) if isinstance(value, tuple) else value
            table.add_row(words, str(shown), f"{gospa:.3f}", f"{likelihood:.2f}")
        plain_console().print(table)


if __name__ == "__main__":
    main()
