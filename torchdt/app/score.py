"""How close estimates come to the truth of a recording, where there is one."""

from torchdt.app.settings import TrackSettings
from torchdt.data.recording import Recording
from torchdt.filter.history import Estimates, StepEstimate, TrackHistory
from torchdt.metrics.gospa import Gospa, gospa


def score_history(history: TrackHistory, recording: Recording, settings: TrackSettings) -> Gospa | None:
    """GOSPA of every run and step, `(B, K)`; None without truth."""
    return _score(history, recording, settings, slice(None), slice(None))


def score_step(
    step: int, estimate: StepEstimate, sequences: slice, recording: Recording, settings: TrackSettings
) -> Gospa | None:
    """GOSPA of one step of some sequences of a recording, `(B,)`; None without truth."""
    return _score(estimate, recording, settings, sequences, step)


def _score(
    estimates: Estimates,
    recording: Recording,
    settings: TrackSettings,
    sequences: slice,
    steps: slice | int,
) -> Gospa | None:
    if recording.truth is None or recording.truth_mask is None:
        return None
    scenario = settings.scenario
    return gospa(
        estimates.position.double().cpu(),
        estimates.declared.cpu(),
        recording.truth[sequences, steps],
        recording.truth_mask[sequences, steps],
        scenario.gospa_cutoff,
        scenario.gospa_order,
        scenario.distance,
    )
