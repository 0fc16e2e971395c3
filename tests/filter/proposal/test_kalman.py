"""Adapted proposals step after step: a linear-Gaussian model against its Kalman filter."""

import math

import pytest
import torch
from oracles.linear_gaussian import kalman_filter

from torchdt.core.mixture import GaussianMixture, cluster_moments
from torchdt.core.random import RandomStreams
from torchdt.core.resampling import scale_tril
from torchdt.core.weights import mean_and_covariance, normalise
from torchdt.filter.proposal.moved import draw_adapted
from torchdt.model.motion.constant_velocity import predict_moments

F64 = torch.float64
RUNS, PARTICLES, VARIANCE = 20, 1000, 0.01
OBSERVED = torch.tensor([0.85, 1.75, 2.6, 3.55, 4.4], dtype=F64)
MEAN, COVARIANCE = torch.tensor([0.0, 0.8], dtype=F64), torch.tensor([[1.0, 0.1], [0.1, 0.2]], dtype=F64)


@pytest.mark.parametrize("deviation", [0.01, 0.5, 20.0])
def test_means_covariances_and_evidence_of_a_linear_gaussian_model(deviation):
    """Observations far sharper than the prediction, alike, and next to none; one cluster throughout.

    Averages over the runs are within 6 standard errors (false alarm of 1e-5 for thirty of Student's)
    and a thousandth; standard errors are at most 0.03 of a deviation, of a variance and of a nat.
    """
    streams = RandomStreams.from_seeds(range(RUNS), (RUNS,), F64)
    state = MEAN + streams.normal(PARTICLES, 2) @ torch.linalg.cholesky(COVARIANCE).mT
    log_weight = torch.full((RUNS, PARTICLES), -math.log(PARTICLES), dtype=F64)
    # Exactly the moments that the Kalman filter starts from.
    mean, covariance = mean_and_covariance(state, log_weight)
    white = torch.linalg.solve(torch.linalg.cholesky(covariance), (state - mean[:, None]).mT).mT
    state = MEAN + white @ torch.linalg.cholesky(COVARIANCE).mT
    means, covariances, evidences = [], [], []
    for y in OBSERVED:
        log_share, mean, covariance = cluster_moments(state, log_weight, 4)
        assert log_share.shape == (RUNS, 1)
        mean, covariance = predict_moments(mean, covariance, 1.0, torch.full((1, 1), VARIANCE, dtype=F64))
        prediction = GaussianMixture(log_share, mean, scale_tril(covariance))

        def log_likelihood(state: torch.Tensor) -> torch.Tensor:
            misfit = (state[..., 0] - y) / deviation  # noqa: B023
            return -0.5 * misfit.square() - math.log(deviation * math.sqrt(2 * math.pi))

        drawn = draw_adapted(
            log_likelihood,
            prediction,
            streams.normal(8, 128, 1),
            streams.normal(PARTICLES, 2),
            log_share.shape[-1],
        )
        state = drawn.state
        log_weight, log_evidence = normalise(drawn.log_prior - drawn.log_proposal + log_likelihood(state))
        mean, covariance = mean_and_covariance(state, log_weight)
        means.append(mean)
        covariances.append(covariance)
        evidences.append(log_evidence)
    F = torch.tensor([[1.0, 1.0], [0.0, 1.0]], dtype=F64)
    W = torch.tensor([[0.5], [1.0]], dtype=F64)
    exact = kalman_filter(OBSERVED, MEAN, COVARIANCE, F, VARIANCE * W @ W.mT, deviation**2)
    spread = exact[1].diagonal(dim1=-2, dim2=-1).sqrt()
    scales = (spread, spread[:, :, None] * spread[:, None, :], torch.ones_like(exact[2]))
    for found, expected, scale in zip((means, covariances, evidences), exact, scales, strict=True):
        error = (torch.stack(found, 1) - expected) / scale
        standard = error.std(0) / RUNS**0.5
        assert standard.max() < 0.03
        assert (error.mean(0).abs() < 6 * standard + 1e-3).all()
