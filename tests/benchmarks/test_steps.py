import math
from unittest import mock

import pytest
import torch
from oracles.line_array import make_tracker, simulate

from benchmarks import steps
from torchdt.core.errors import InputError
from torchdt.core.random import RandomStreams
from torchdt.data.recording import validate
from torchdt.filter.proposal.adapted import Adapted

pytestmark = pytest.mark.slow
PATHS = (((0.0, -20.0), (20.0, -20.0)), ((0.0, 30.0), (20.0, 30.0)))
PARTS = [
    "field",
    "prediction",
    "moment matching",
    "messages of one sweep",
    "update",
    "noise update",
    "search for new objects",
    "newborn proposal",
    "placement",
    "resampling",
    "evidence",
    "conclusion",
    "whole step",
    "whole step, kept for the gradient",
    "gradient",
]


@pytest.fixture(scope="module")
def tracker():
    return make_tracker(particles=50, proposal=Adapted(rounds=2, round_size=32))


@pytest.fixture(scope="module")
def recording():
    """Two sequences of two sources."""
    data = [simulate(seed, *PATHS, steps=4)[0] for seed in (0, 1)]
    return validate(snapshots=torch.stack(data), step_s=1.0)


@pytest.fixture(scope="module")
def reached(tracker, recording):
    """State after two steps, measurement, priors and streams."""
    prepared = tracker.prepare(validate(snapshots=recording.data[:1], step_s=1.0))
    streams = RandomStreams.from_seeds([0], (1,), torch.float64)
    state = tracker.init(prepared.priors)
    with torch.no_grad():
        for k in range(2):
            state, _ = tracker.step(state, prepared.measurement.at(k), prepared.priors, streams)
    return state, prepared.measurement.at(2), prepared.priors, streams


def test_every_part_has_a_time_and_a_share(tracker, recording):
    rows = {row.quantity: row for row in steps.measure_step(tracker, recording, 2, 1)}
    assert [name for name, row in rows.items() if row.unit == "ms"] == PARTS
    whole = rows["whole step"].value
    for name in set(PARTS) - {"whole step"}:
        assert 0 < rows[name].value < math.inf
        assert rows[f"{name} / whole step"].value == pytest.approx(rows[name].value / whole)
    assert rows["times real time"].value == pytest.approx(1e3 / whole)
    assert "steps of 1 s" in rows["times real time"].note
    assert rows["field"].note == "50 particles"
    assert rows["prediction"].note.startswith("2 objects")
    assert rows["newborn proposal"].note.startswith("2 objects")


def test_the_parts_do_what_the_step_does(tracker, reached):
    state, measurement, priors, streams = reached
    began = streams.snapshot()
    with torch.no_grad():
        parts = steps.forward_parts(tracker, state, measurement, priors, streams.at(began))
        _, expected = tracker.step(state, measurement, priors, streams.at(began))
        existence = torch.sigmoid(parts["update"][0]().objects.log_odds)
        _, _, concluded = parts["conclusion"][0]()
        log_evidence = parts["evidence"][0]()
    assert existence.shape == (1, 2)
    torch.testing.assert_close(existence.sort().values, expected.existence[:, :2].sort().values)
    torch.testing.assert_close(concluded.state, expected.state)
    # Beside what is undetected, of which there are few: mu_B / (1 - p_s) at most.
    torch.testing.assert_close(log_evidence, expected.log_evidence, rtol=0, atol=1e-2)


def test_the_newborn_are_the_sources_themselves(tracker, reached):
    state, measurement, priors, streams = reached
    with torch.no_grad():
        parts = steps.forward_parts(tracker, state, measurement, priors, streams)
        born, _ = parts["newborn proposal"][0]()
        nothing_new, _, _ = parts["search for new objects"][0]()
    assert nothing_new is None
    bearings = born.state[0, :, :, 0].mean(-1).sort().values
    torch.testing.assert_close(bearings, torch.tensor([-20.0, 30.0]).double(), rtol=0, atol=2.0)


def test_the_gradient_reaches_parameters_and_state(tracker, reached):
    forward, backward = (call for call, _ in steps.gradient_parts(tracker, *reached).values())
    assert forward()[1].log_evidence.requires_grad
    survival = backward()[list(tracker.model.known()).index("survival")]
    assert survival.isfinite()
    assert survival != 0


def test_data_without_a_source_are_refused(tracker):
    noise = torch.randn(1, 12, 2, 3, 8, dtype=torch.complex128, generator=torch.Generator().manual_seed(0))
    with pytest.raises(InputError, match="key 'overrides': found a step in which nothing is found"):
        steps.measure_step(tracker, validate(snapshots=noise, step_s=1.0), 11, 1)


def test_a_batch_and_its_sequences_take_turns(tracker, recording):
    with mock.patch.object(steps, "track", wraps=steps.track) as track:
        rows = {row.quantity: row for row in steps.measure_batch(tracker, recording, 2)}
    batches = [len(call.args[2]) for call in track.call_args_list]
    assert batches == [2, 2, 1, 1] * 2, "each once more, to be warm"
    alone = [list(call.args[2]) for call in track.call_args_list if len(call.args[2]) == 1]
    assert alone == [[0], [1]] * 2
    assert rows["batch of 2"].value > 0
    ratio = rows["batch of 2"].value / rows["one sequence"].value
    assert rows["batch / one sequence"].value == pytest.approx(ratio)
    assert rows["one sequence"].note == "4 steps"
