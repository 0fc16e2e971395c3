import torch
from oracles.tart import SIZE, scene

from recordings.tart_count import effective_count
from torchdt.baselines.detect.config import PursuitConfig
from torchdt.baselines.detect.pursuit import MatchingPursuit
from torchdt.filter.proposal.dictionary import build_dictionary

STEPS = 400


def test_counts_the_snapshots_where_the_model_is_right():
    """E |W - I|^2 = M^2 / J. It deviates by less than half in a step at J = 40, so by 2.5 % over all
    steps; fitted points take about 2 of M^2 = 100. 15 % is beyond six deviations."""
    field, region, covariance = scene(0)
    stream = torch.Generator().manual_seed(2)
    draws = torch.randn(STEPS, SIZE, 40, generator=stream, dtype=torch.complex128)
    snapshots = torch.linalg.cholesky(covariance[0]) @ draws
    sample = snapshots @ snapshots.mH / 40
    config = PursuitConfig(points=2, threshold=0.0, pick_threshold=0.0)
    detector = MatchingPursuit(field, region, build_dictionary(field, region), config)
    assert abs(effective_count(sample, field, detector) / 40 - 1) < 0.15


def test_a_wrong_model_counts_for_less():
    field, region, covariance = scene(0)
    stream = torch.Generator().manual_seed(3)
    draws = torch.randn(50, SIZE, 40, generator=stream, dtype=torch.complex128)
    snapshots = torch.linalg.cholesky(covariance[0]) @ draws
    config = PursuitConfig(points=1, threshold=0.0, pick_threshold=0.0)
    detector = MatchingPursuit(field, region, build_dictionary(field, region), config)
    assert effective_count(snapshots @ snapshots.mH / 40, field, detector) < 30
