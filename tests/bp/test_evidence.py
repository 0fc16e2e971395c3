import numpy as np
import pytest
import torch
from oracles.arrays import direct_log_likelihood
from oracles.enumeration import enumerate_pair
from oracles.scenes import make_scene

from torchdt.bp.evidence import gaussian_evidence
from torchdt.bp.schedule import initial_beliefs

REGIONS = ((-40.0, 0.0), (5.0, 45.0))


def test_without_objects_and_with_known_noise_it_is_exact():
    scene = make_scene(1, (), (), REGIONS, num_noise=1, prior_existence=(1e-300, 1e-300))
    evidence = gaussian_evidence(initial_beliefs(scene.prior, scene.response, scene.noise), scene.measurement)
    assert evidence.item() == pytest.approx(enumerate_pair(scene.problem).log_evidence, rel=1e-12)


def test_with_objects_it_is_the_moment_matched_gaussian():
    scene = make_scene(1, (-20.0,), (4.0,), REGIONS)
    beliefs = initial_beliefs(scene.prior, scene.response, scene.noise)
    covariance = scene.noise.variance.mean(-1)[:, None, None] * torch.eye(8)
    for n in range(2):
        for x in range(120):
            a = scene.response[n, :, x]
            power = 0.1 * scene.prior.power[n].mean(-1) / 120
            covariance = covariance + power[:, None, None] * a[:, :, None] * a[:, None, :].conj()
    expected = direct_log_likelihood(scene.measurement.factor.mT, covariance).sum()
    assert gaussian_evidence(beliefs, scene.measurement).item() == pytest.approx(expected.item(), rel=1e-12)
    assert np.isfinite(expected.item())
