import itertools
import math

import pytest
import torch
from oracles.line_array import make_field

from studies.told import told_log_odds, track_evidence

FIELD = make_field()
NOISE, SURVIVAL, BIRTH = 0.3, 0.9, 0.05


def log_density(z, covariance):
    """Of snapshots `(J, M)`, each circular complex normal, by the determinant and the inverse."""
    exponent = torch.einsum("jm,mn,jn->", z.conj(), torch.linalg.inv(covariance), z).real
    log_det = math.log(torch.linalg.det(covariance).real)
    return -len(z) * (covariance.shape[-1] * math.log(math.pi) + log_det) - exponent.item()


@pytest.fixture(scope="module")
def problem():
    """Four steps of two tones and two snapshots, in which a source is there now and then."""
    stream = torch.Generator().manual_seed(3)
    track = torch.tensor([[-20.0], [-18.0], [-16.5], [-15.0]], dtype=torch.float64)
    shape = (4, FIELD.num_tones, 2, FIELD.num_sensors)
    z = NOISE**0.5 * torch.randn(shape, generator=stream, dtype=torch.complex128)
    rho = torch.randn(shape[:3], generator=stream, dtype=torch.complex128)
    response = FIELD(track)
    z[1:3] += 0.9 * rho[1:3, ..., None] * response[1:3, :, None]
    return z, track, response


def test_evidence_is_the_ratio_of_two_densities(problem):
    z, track, response = problem
    power = torch.tensor([0.8], dtype=torch.float64)
    found = track_evidence(z[None], FIELD, track[None], power, NOISE)[0]
    eye = NOISE * torch.eye(FIELD.num_sensors, dtype=z.dtype)
    for k, nats in enumerate(found.tolist()):
        pairs = list(zip(z[k], response[k], strict=True))
        there = sum(log_density(s, 0.8 * torch.outer(a, a.conj()) + eye) for s, a in pairs)
        assert nats == pytest.approx(there - sum(log_density(s, eye) for s, _ in pairs), abs=1e-9)


def test_the_filter_is_that_of_all_histories(problem):
    """Existence in every step, by the sum over all courses of being there and not being there."""
    z, track, _ = problem
    evidence = track_evidence(z[None], FIELD, track[None], torch.tensor([0.8], dtype=torch.float64), NOISE)
    found = told_log_odds(evidence, SURVIVAL, BIRTH)[0]
    for k in range(len(z)):
        weight = [0.0, 0.0]
        for course in itertools.product((0, 1), repeat=k + 1):
            probability, before = 1.0, 0
            for step, there in enumerate(course):
                goes_on = SURVIVAL if before else BIRTH
                probability *= goes_on if there else 1 - goes_on
                probability *= math.exp(evidence[0, step] * there)
                before = there
            weight[course[-1]] += probability
        assert found[k].item() == pytest.approx(math.log(weight[1] / weight[0]), abs=1e-9)
