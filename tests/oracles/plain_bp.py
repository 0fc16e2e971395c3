"""Belief propagation of one step in plain NumPy: double precision, one sequence, a loop over everything
but particles and power points.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Tone(NamedTuple):
    """One tone of N objects and the data, on the M sensors that are heard.

    response (N, P, M) complex, power and log_power (N, G), variance and log_noise (E,), factor (M, R) complex
    with S = B B^H, and the number of snapshots J.
    """

    response: NDArray
    power: NDArray
    log_power: NDArray
    variance: NDArray
    log_noise: NDArray
    factor: NDArray
    J: float


class Problem(NamedTuple):
    """Predicted log-weights (N, P), log-odds (N,), and the tones."""

    log_weight: NDArray
    log_odds: NDArray
    tones: list[Tone]


class Posterior(NamedTuple):
    """log_weight (N, P), log_power (N, I, G), log_odds (N,), log_noise (I, E), strength r E[gamma] (N, I),
    and for every tone the moments E[a a^H] (N, M, M) on the sensors that are heard.
    """

    log_weight: NDArray
    log_power: NDArray
    log_odds: NDArray
    log_noise: NDArray
    strength: NDArray
    moment: list[NDArray]


def make_problem(
    log_weight: NDArray,
    log_odds: NDArray,
    power: NDArray,
    log_power: NDArray,
    response: NDArray,
    variance: NDArray,
    log_noise: NDArray,
    factor: NDArray,
    J: NDArray,
    present: NDArray,
) -> Problem:
    """Arrays (N, P), (N,), (N, I, G) twice, (N, I, P, M), (I, E) twice, (I, M, R), (I,), (I, M)."""
    tones = []
    for i, heard in enumerate(present.astype(bool)):
        real = (x.astype(float) for x in (power[:, i], log_power[:, i], variance[i], log_noise[i]))
        a, B = response[:, i][..., heard].astype(complex), factor[i, heard].astype(complex)
        tones.append(Tone(a, *real, B, float(J[i])))
    return Problem(log_weight.astype(float), log_odds.astype(float), tones)


def by_rank_one(background: NDArray, response: NDArray, power: NDArray, factor: NDArray, J: float) -> NDArray:
    """log CN(B; 0, Sigma + gamma a a^H) - log CN(B; 0, Sigma) by determinant lemma and Sherman-Morrison.

    background (M, M), response (P, M), power (G,), factor (M, R); result (P, G).
    """
    solved = np.linalg.solve(background, response.T)
    s = (response.conj().T * solved).sum(0).real
    q = (np.abs(factor.conj().T @ solved) ** 2).sum(0)
    gain = power * s[:, None]
    return power * q[:, None] / (1 + gain) - J * np.log1p(gain)


def by_cholesky(background: NDArray, response: NDArray, power: NDArray, factor: NDArray, J: float) -> NDArray:
    """The same with one Cholesky factorisation per particle and power point."""
    outer = response[:, :, None] * response[:, None, :].conj()
    columns = [log_density(background + gamma * outer, factor, J) for gamma in power]
    return np.stack(columns, -1) - log_density(background[None], factor, J)


def log_density(covariance: NDArray, factor: NDArray, J: float) -> NDArray:
    """-J log|C| - tr(C^-1 S) of a stack (P, M, M), without the constant."""
    lower = np.linalg.cholesky(covariance)
    log_det = 2 * np.log(np.diagonal(lower, axis1=-2, axis2=-1).real).sum(-1)
    # Forward substitution: np.linalg.solve would factorise once more.
    whitened = np.zeros((len(lower), *factor.shape), complex)
    for m, row in enumerate(factor):
        known = (lower[:, m, None, :m] @ whitened[:, :m])[:, 0]
        whitened[:, m] = (row - known) / lower[:, m, m, None]
    return -J * log_det - (np.abs(whitened) ** 2).sum((-2, -1))


def update(problem: Problem, sweeps: int = 3, log_ratios=by_rank_one) -> Posterior:
    """Sweep over the objects, strongest first, and the noise after each sweep."""
    tones, predicted = problem.tones, problem.log_odds
    log_weight, log_odds = problem.log_weight.copy(), predicted.copy()
    log_power = np.stack([tone.log_power for tone in tones], 1)
    log_noise = np.stack([tone.log_noise for tone in tones])
    moment = [
        np.stack([second_moment(a, w) for a, w in zip(t.response, log_weight, strict=True)]) for t in tones
    ]
    mean_power = (np.exp(log_power) * np.stack([tone.power for tone in tones], 1)).sum(-1)
    strength = sigmoid(log_odds)[:, None] * mean_power
    for _ in range(sweeps):
        for n in np.argsort(-strength.sum(-1), kind="stable"):
            if np.isneginf(predicted[n]):
                continue
            ratios = []
            for i, tone in enumerate(tones):
                eta = (np.exp(log_noise[i]) * tone.variance).sum()
                others = np.where(np.arange(len(strength)) == n, 0.0, strength[:, i])
                Sigma = background(others, moment[i], eta)
                ratios.append(log_ratios(Sigma, tone.response[n], tone.power[n], tone.factor, tone.J))
            messages = [log_sum_exp(t.log_power[n] + ell, 1) for t, ell in zip(tones, ratios, strict=True)]
            joint = problem.log_weight[n] + sum(messages)
            evidence = log_sum_exp(joint, 0)
            log_weight[n] = joint - evidence
            log_odds[n] = predicted[n] + evidence
            existence = sigmoid(log_odds[n])
            for i, (tone, ell, message) in enumerate(zip(tones, ratios, messages, strict=True)):
                # What the other tones say of the state, times this tone's likelihood.
                likelihood = log_sum_exp((log_weight[n] - message)[:, None] + ell, 0)
                belief = tone.log_power[n] + likelihood
                log_power[n, i] = belief - log_sum_exp(belief, 0)
                strength[n, i] = existence * (np.exp(log_power[n, i]) * tone.power[n]).sum()
                moment[i][n] = second_moment(tone.response[n], log_weight[n])
        for i, tone in enumerate(tones):
            log_noise[i] = update_noise(tone, background(strength[:, i], moment[i], 0.0))
    return Posterior(log_weight, log_power, log_odds, log_noise, strength, moment)


def second_moment(response: NDArray, log_weight: NDArray) -> NDArray:
    """E[a a^H] of (P, M) responses."""
    return (response.T * np.exp(log_weight)) @ response.conj()


def background(strength: NDArray, moment: NDArray, eta: float) -> NDArray:
    """Sum of strength (N,) times moment (N, M, M), plus eta I."""
    return np.tensordot(strength, moment, 1) + eta * np.eye(moment.shape[-1])


def update_noise(tone: Tone, signal: NDArray) -> NDArray:
    """Log-weights (E,) of the noise points given a signal covariance (M, M)."""
    eigenvalue, eigenvector = np.linalg.eigh(signal)
    energy = (np.abs(eigenvector.conj().T @ tone.factor) ** 2).sum(-1)
    level = eigenvalue + tone.variance[:, None]
    belief = tone.log_noise - (tone.J * np.log(level) + energy / level).sum(-1)
    return belief - log_sum_exp(belief, 0)


def log_sum_exp(values: NDArray, axis: int) -> NDArray:
    top = values.max(axis, keepdims=True)
    return (top + np.log(np.exp(values - top).sum(axis, keepdims=True))).squeeze(axis)


def sigmoid(log_odds: NDArray) -> NDArray:
    return np.exp(-np.logaddexp(0.0, -log_odds))
