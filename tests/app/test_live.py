"""What goes into the event files of a run; `test_tensorboard.py` reads those of whole runs."""

from dataclasses import replace
from unittest import mock

import pytest
import torch

from torchdt.app import live
from torchdt.app.build import build_region
from torchdt.filter.history import StepEstimate


@pytest.fixture
def report(recording, settings, tmp_path):
    """Of two sequences whose truth differs, and what it calls to write."""
    differing = recording.truth + torch.tensor([0.0, 1.0]).reshape(2, 1, 1, 1)
    chosen = settings("runs=2", "logging.tensorboard=true")
    with mock.patch.object(live, "TensorBoardReport") as written:
        yield (
            live.LiveReport(
                tmp_path, replace(recording, truth=differing), build_region(chosen, torch.float32), chosen
            ),
            written.return_value,
        )


@pytest.mark.slow
def test_all_that_is_written_of_a_step_is_of_the_first_sequence(report, recording):
    live_report, written = report
    first = torch.zeros(1, 3, 2, dtype=torch.float64)
    estimate = StepEstimate(*[torch.cat([first, first + 1])] * len(StepEstimate._fields))._replace(
        declared=torch.tensor([[False] * 3, [True] * 3]), position=torch.zeros(2, 3, 1, dtype=torch.float64)
    )
    live_report(3, torch.tensor([4.0, 5.0]), estimate, slice(0, 2))
    live_report(3, torch.tensor([5.0]), estimate, slice(1, 2))
    ((step, time_s, state, found, score, truth),) = (call.args for call in written.add_step.call_args_list)
    assert (step, time_s, state) == (3, recording.times()[0, 3], 4.0)
    assert torch.equal(found.existence, first[0])
    assert score.num_estimated == 0
    torch.testing.assert_close(truth, recording.truth[0, 3], rtol=0, atol=0, equal_nan=True)


def test_files_are_closed_whatever_happens(report):
    live_report, written = report
    live_report._opened(0)
    with pytest.raises(RuntimeError, match="stopped"), live_report:
        raise RuntimeError("stopped")
    written.close.assert_called_once_with()
