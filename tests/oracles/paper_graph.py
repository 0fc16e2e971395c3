"""The factor graph of the paper in plain NumPy: densities of whole covariances, sums written out, messages as
they are; and the exact marginals of one object, by enumeration. One sequence, double precision.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Graph:
    """N objects, I tones, J snapshots, M sensors.

    response (N, I, P, M), state (N, P) alpha, power and psi (N, I, G), existence (N,), variance and xi
    (I, E), data (J, I, M). alpha, psi and xi are weights that add up to one.
    """

    response: NDArray
    state: NDArray
    power: NDArray
    psi: NDArray
    existence: NDArray
    variance: NDArray
    xi: NDArray
    data: NDArray


@dataclass(frozen=True)
class Marginals:
    """state (N, P), power (N, I, G) given existence, existence (N,), noise (I, E)."""

    state: NDArray
    power: NDArray
    existence: NDArray
    noise: NDArray


def density(z: NDArray, covariance: NDArray) -> float:
    quadratic = (z.conj() @ np.linalg.solve(covariance, z)).real
    return np.exp(-quadratic) / np.linalg.det(np.pi * covariance).real


def outer(a: NDArray) -> NDArray:
    return np.outer(a, a.conj())


def enumerate_one(g: Graph) -> Marginals:
    """Exact marginals of one object: every state, existence, power and noise variance of every tone."""
    _, tones, P, M = g.response.shape
    G, E = g.power.shape[-1], g.variance.shape[-1]
    state, power, noise = np.zeros((1, P)), np.zeros((1, tones, G)), np.zeros((tones, E))
    exists, total = 0.0, 0.0
    for p, r in product(range(P), (0, 1)):
        prior = g.state[0, p] * (g.existence[0] if r else 1 - g.existence[0])
        # Given x and r the tones are independent: one table (G, E) each.
        tables = np.empty((tones, G, E))
        for i, k, e in np.ndindex(tones, G, E):
            C = r * g.power[0, i, k] * outer(g.response[0, i, p]) + g.variance[i, e] * np.eye(M)
            likelihood = np.prod([density(z, C) for z in g.data[:, i]])
            tables[i, k, e] = g.psi[0, i, k] * g.xi[i, e] * likelihood
        sums = tables.sum((1, 2))
        weight = prior * sums.prod()
        total += weight
        state[0, p] += weight
        exists += r * weight
        for i in range(tones):
            share = weight * tables[i] / sums[i]
            noise[i] += share.sum(0)
            power[0, i] += r * share.sum(1)
    return Marginals(state / total, power / exists, np.array([exists / total]), noise / total)


def flood(g: Graph, iterations: int) -> Marginals:
    """Beliefs after messages of all factors at once; all but their receiver is moment-matched."""
    N, tones, P, M = g.response.shape
    G, E, J = g.power.shape[-1], g.variance.shape[-1], len(g.data)
    kappa, nu = np.ones((N, tones, J, P)), np.ones((tones, J, E))
    # lambda over (r = 0) and the powers of the factor's tone.
    silent, lam = np.ones((N, tones, J)), np.ones((N, tones, J, G))

    def phi(n: int, skip: tuple[int, int] | None, tone: int) -> tuple[float, NDArray]:
        """Existence, and weights of one tone's powers given it, without what one factor says."""
        exists, absent, powers = g.existence[n], 1 - g.existence[n], np.ones(G)
        for i in range(tones):
            said = g.psi[n, i].copy()
            for j in range(J):
                if (i, j) != skip:
                    said, absent = said * lam[n, i, j], absent * silent[n, i, j]
            exists = exists * said.sum()
            if i == tone:
                powers = said / said.sum()
        return exists / (exists + absent), powers

    def normal(weight: NDArray) -> NDArray:
        return weight / weight.sum()

    for _ in range(iterations):
        new = kappa.copy(), silent.copy(), lam.copy(), nu.copy()
        for i, j in product(range(tones), range(J)):
            z = g.data[j, i]
            others = [(a, b) for a, b in product(range(tones), range(J)) if (a, b) != (i, j)]
            beta = [
                normal(g.state[n] * np.prod([kappa[n, a, b] for a, b in others] or [1.0], axis=0))
                for n in range(N)
            ]
            zeta = [phi(n, (i, j), i) for n in range(N)]
            iota = normal(g.xi[i] * np.prod([nu[i, b] for b in range(J) if b != j] or [np.ones(E)], axis=0))
            mean = [
                zeta[n][0]
                * (zeta[n][1] @ g.power[n, i])
                * sum(beta[n][p] * outer(g.response[n, i, p]) for p in range(P))
                for n in range(N)
            ]
            for n in range(N):
                background = sum((mean[m] for m in range(N) if m != n), iota @ g.variance[i] * np.eye(M))
                r, powers = zeta[n]
                table = np.array(
                    [
                        [density(z, background + gamma * outer(a)) for a in g.response[n, i]]
                        for gamma in g.power[n, i]
                    ]
                )
                new[0][n, i, j] = (1 - r) * density(z, background) + r * (powers @ table)
                new[1][n, i, j] = density(z, background)
                new[2][n, i, j] = table @ beta[n]
            new[3][i, j] = [density(z, sum(mean) + eta * np.eye(M)) for eta in g.variance[i]]
        kappa, silent, lam, nu = new
    beliefs = [[phi(n, None, i) for i in range(tones)] for n in range(N)]
    return Marginals(
        np.array([normal(g.state[n] * kappa[n].prod((0, 1))) for n in range(N)]),
        np.array([[powers for _, powers in tones] for tones in beliefs]),
        np.array([tones[0][0] for tones in beliefs]),
        np.array([normal(g.xi[i] * nu[i].prod(0)) for i in range(tones)]),
    )


def random_graph(
    seed: int,
    objects: int,
    tones: int,
    snapshots: int,
    states: int,
    powers: int,
    noises: int,
    sensors: int = 4,
) -> Graph:
    """Random responses, weights and data; the first object sends, from its first state."""
    rng = np.random.default_rng(seed)

    def gaussian(*shape: int) -> NDArray:
        return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)

    def weights(*shape: int) -> NDArray:
        raw = rng.uniform(0.5, 1.5, shape)
        return raw / raw.sum(-1, keepdims=True)

    response = gaussian(objects, tones, states, sensors)
    data = gaussian(snapshots, tones, 1) * response[0, :, 0] + 0.7 * gaussian(snapshots, tones, sensors)
    return Graph(
        response,
        weights(objects, states),
        rng.uniform(0.3, 3.0, (objects, tones, powers)),
        weights(objects, tones, powers),
        rng.uniform(0.2, 0.8, objects),
        rng.uniform(0.3, 0.8, (tones, noises)),
        weights(tones, noises),
        data,
    )


def known_object(g: Graph, n: int) -> Graph:
    """The same with one object's state, powers and existence as good as known: the first ones."""
    state, psi, existence = g.state.copy(), g.psi.copy(), g.existence.copy()
    state[n], psi[n], existence[n] = 0.0, 0.0, 1 - 1e-15
    state[n, 0], psi[n, :, 0] = 1.0, 1.0
    return replace(g, state=state, psi=psi, existence=existence)
