"""Environments of simulated runs."""

from unittest import mock

import pytest

from torchdt.app import build

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("seed", "shared"), [(None, False), (5, True)])
def test_runs_share_one_environment_if_it_has_a_seed(settings, seed, shared):
    drawn = []

    def record(*arguments):
        drawn.append(draw(*arguments))
        return drawn[-1]

    draw = build.draw_environment
    chosen = settings("scenario=mismatch", "field.freqs=[49]", "scenario.num_steps=1", "runs=2", small=False)
    chosen.scenario.mismatch.seed = seed
    with mock.patch.object(build, "draw_environment", record):
        recording = build.simulate(chosen)
    assert (drawn[0] == drawn[1]) == shared
    assert not recording.snapshots[0].equal(recording.snapshots[1])
