"""Exact marginals of two potential objects on grids, by summing over every configuration (NumPy, float64)."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Problem:
    """Two objects, each on its own grid of responses, with discrete powers and noise variances.

    `response[n]` is (X, I, M); `log_prior_state[n]` is (X,); `power`, `log_power` are (I, G);
    `noise`, `log_noise` are (I, E); `scatter` is (I, M, M), `count` J, `existence[n]` the prior r.
    """

    response: tuple[Array, Array]
    log_prior_state: tuple[Array, Array]
    existence: tuple[float, float]
    power: Array
    log_power: Array
    noise: Array
    log_noise: Array
    scatter: Array
    count: float


@dataclass(frozen=True)
class Marginals:
    """Existence (2,), state marginals given existence (2, X) and log evidence."""

    existence: Array
    state: tuple[Array, Array]
    log_evidence: float


def log_likelihood_pair(a1: Array, a2: Array, g1: Array, g2: Array, eta: Array, S: Array, J: float) -> Array:
    """log CN of J snapshots for C = g1 a1 a1^H + g2 a2 a2^H + eta I; all leading dims broadcast."""
    M = S.shape[-1]
    g11 = np.sum(np.abs(a1) ** 2, -1)
    g22 = np.sum(np.abs(a2) ** 2, -1)
    g12 = np.sum(a1.conj() * a2, -1)
    b1, b2 = np.einsum("mk,...k->...m", S, a1), np.einsum("mk,...k->...m", S, a2)
    s11 = np.sum(a1.conj() * b1, -1).real
    s22 = np.sum(a2.conj() * b2, -1).real
    s12 = np.sum(a1.conj() * b2, -1)
    # K = I + Gamma^(1/2) A^H A Gamma^(1/2) / eta, written out for two columns.
    k11, k22 = 1 + g1 * g11 / eta, 1 + g2 * g22 / eta
    k12 = np.sqrt(g1 * g2) * g12 / eta
    det = k11 * k22 - np.abs(k12) ** 2
    quad = (g1 * s11 * k22 + g2 * s22 * k11 - 2 * np.real(np.sqrt(g1 * g2) * k12.conj() * s12)) / det
    trace = (np.trace(S).real - quad / eta) / eta
    return -J * (M * np.log(np.pi) + M * np.log(eta) + np.log(det)) - trace


def _logsumexp(x: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    top = np.max(x, axis=axis, keepdims=True)
    return np.squeeze(np.log(np.sum(np.exp(x - top), axis=axis, keepdims=True)) + top, axis=axis)


def enumerate_pair(p: Problem) -> Marginals:
    """Sum over r1, r2, x1, x2, both powers and the noise of every tone."""
    shapes = [r.shape[0] for r in p.response]
    joint = np.zeros((2, 2, *shapes))
    for i, r1, r2 in itertools.product(range(p.scatter.shape[0]), (0, 1), (0, 1)):
        a2 = p.response[1][: None if r2 else 1, i][:, None, None, None]
        g = p.power[i]
        weight = p.log_power[i][:, None, None] + p.log_power[i][:, None] + p.log_noise[i]
        for x1 in range(shapes[0] if r1 else 1):  # an absent object is the same in every state
            a1 = p.response[0][x1, i][None, None, None, None]
            like = log_likelihood_pair(
                a1, a2, r1 * g[:, None, None], r2 * g[:, None], p.noise[i], p.scatter[i], p.count
            )
            joint[r1, r2, x1 if r1 else slice(None)] += _logsumexp(like + weight, axis=(1, 2, 3))
    for n, axis in ((0, 2), (1, 3)):
        shape = [1, 1, 1, 1]
        shape[axis] = -1
        joint = joint + p.log_prior_state[n].reshape(shape)
        exists = np.log([1 - p.existence[n], p.existence[n]])
        joint = joint + exists.reshape([-1 if d == n else 1 for d in range(4)])
    evidence = _logsumexp(joint)
    post = np.exp(joint - evidence)
    state1, state2 = post[1].sum((0, 2)), post[:, 1].sum((0, 1))
    return Marginals(
        np.array([post[1].sum(), post[:, 1].sum()]),
        (state1 / state1.sum(), state2 / state2.sum()),
        float(evidence),
    )
