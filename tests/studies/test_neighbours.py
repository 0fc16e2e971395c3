"""Random scenes of neighbours, and their enumeration."""

import pytest
import torch

from studies.neighbours import all_errors, draw_scene, enumerate_scene, evidence, messages, summary
from torchdt.filter.bp.schedule import Sequential


@pytest.mark.parametrize("seed", [0, 2])
def test_enumeration_agrees_with_sampling(seed):
    """Of two objects, noise unknown and known; unbiased whatever the beliefs are."""
    scene = draw_scene(seed)
    estimate = evidence(scene, messages(scene, Sequential()), seed, 20000)
    assert abs(estimate - enumerate_scene(scene).log_evidence) < 0.03


def test_errors_and_their_summary():
    found = [all_errors(draw_scene(seed), seed) for seed in (4, 6)]
    assert set(found[0]) == {"flooding", "sequential", "sequential, 12 sweeps", "joint"}
    numbers = summary([f["joint"] for f in found])
    error = torch.cat([f["joint"].existence for f in found])
    assert numbers[0] == pytest.approx(float(error.mean()))
    assert numbers[1] == pytest.approx(float(error.square().mean().sqrt()))
    assert all(abs(x) < 0.2 for x in numbers)
