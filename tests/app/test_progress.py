"""Bars of the jobs, of which `test_runs.py` sees that of tracking in whole runs."""

import contextlib
import io
from unittest import mock

import pytest
import torch
from hydra import compose, initialize_config_module
from oracles.scripts import Terminal

from torchdt.app import progress
from torchdt.app.settings import settings_of
from torchdt.filter.history import StepEstimate
from torchdt.tuning.state import Record, TuningState


@pytest.fixture(scope="module")
def tuning():
    with initialize_config_module("torchdt.conf", version_base="1.3"):
        return {
            name: settings_of(compose("tune", overrides=[f"tuning={name}", "tuning.steps=4"]))
            for name in ("gradient", "grid")
        }


@contextlib.contextmanager
def printed(alone=True, stream=Terminal):
    out = stream()
    with mock.patch.object(progress, "is_alone", return_value=alone), contextlib.redirect_stderr(out):
        yield out


def state():
    records = [Record(k, {}, -1.5, {}, None, 1, 3 * (k + 1)) for k in range(2)]
    return TuningState({}, {}, best_heldout=-1.25, records=tuple(records))


def test_steps_or_passes_of_tuning(tuning):
    with printed() as out, progress.tune_progress(tuning["gradient"]) as advance:
        advance(state())
    for words in ("step", "2/5", "objective -1.5000", "held-out -1.2500", "skipped 1"):
        assert words in out.getvalue()
    with printed() as out, progress.tune_progress(tuning["grid"]) as advance:
        advance(state())
    for words in ("pass", f"6/{tuning['grid'].tuning.budget_passes}"):
        assert words in out.getvalue()


@pytest.mark.parametrize("where", [{"alone": False}, {"stream": io.StringIO}])
def test_no_bar_in_a_sweep_and_without_a_terminal(tuning, where):
    with printed(**where) as out, progress.tune_progress(tuning["gradient"]) as advance:
        advance(state())
    assert out.getvalue() == ""


def test_a_bar_that_goes_on(recording, settings):
    """Two sequences of five steps in chunks of their own, the first of which was done before."""
    declared = torch.ones(1, 3, dtype=torch.bool)
    estimate = StepEstimate(*[torch.zeros(1, 3, 1)] * len(StepEstimate._fields))._replace(declared=declared)
    with printed() as out, progress.track_progress(recording, settings("runs=2")) as on_step:
        on_step(4, None, estimate, slice(0, 1))
        on_step(2, None, estimate, slice(1, 2))
    assert "8/10" in out.getvalue()
    assert "declared 3" in out.getvalue()
