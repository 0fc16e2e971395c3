"""Sparse Bayesian learning in plain NumPy: double precision, all columns in every iteration."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter


class Learned(NamedTuple):
    """Powers (C,), noise variances (I,), and how many iterations they took."""

    power: NDArray
    noise: NDArray
    iterations: int


def column_sums(dictionary: NDArray, power: NDArray, noise: NDArray, scatter: NDArray) -> tuple:
    """Numerator and denominator of the update, (C,) each, by matrix products.

    dictionary (I, M, C) complex, power (C,), noise (I,), scatter (I, M, M) = S / J.
    """
    top, bottom = np.zeros(len(power)), np.zeros(len(power))
    for a, eta, S in zip(dictionary, noise, scatter, strict=True):
        inverse = np.linalg.inv((a * power) @ a.conj().T + eta * np.eye(len(a)))
        whitened = inverse @ a
        bottom += (a.conj() * whitened).sum(0).real
        top += (whitened.conj() * (S @ whitened)).sum(0).real
    return top, bottom


def outer_products(dictionary: NDArray, power: NDArray, noise: NDArray, scatter: NDArray) -> tuple:
    """The same, straight from the formulas: with an M x M matrix for every column of the grid."""
    top, bottom = np.zeros(len(power)), np.zeros(len(power))
    for a, eta, S in zip(dictionary, noise, scatter, strict=True):
        outer = a[:, None, :] * a.conj()[None, :, :]
        inverse = np.linalg.inv((power * outer).sum(-1) + eta * np.eye(len(a)))
        # tr(X a a^H) = sum_mn X_nm (a a^H)_mn
        bottom += (inverse.T[..., None] * outer).sum((0, 1)).real
        top += ((inverse @ S @ inverse).T[..., None] * outer).sum((0, 1)).real
    return top, bottom


def strongest_peaks(power: NDArray, grid_shape: tuple, number: int) -> NDArray:
    """Indices of the highest cells that no neighbour exceeds."""
    surface = power.reshape(grid_shape)
    peak = ((maximum_filter(surface, size=3, mode="constant") == surface) & (surface > 0)).ravel()
    return np.argsort(np.where(peak, -power, np.inf), kind="stable")[: min(number, peak.sum())]


def residual_noise(dictionary: NDArray, scatter: NDArray, columns: NDArray) -> NDArray:
    """tr[(I - A A^+) S / J] / (M - K) of every tone."""
    sensors = dictionary.shape[1]
    noise = []
    for a, S in zip(dictionary[..., columns], scatter, strict=True):
        outside = np.eye(sensors) - a @ np.linalg.pinv(a)
        noise.append(np.trace(outside @ S).real / (sensors - len(columns)))
    return np.array(noise)


def objective(dictionary: NDArray, power: NDArray, noise: NDArray, scatter: NDArray) -> float:
    """Minus the log evidence of one snapshot, up to a constant."""
    value = 0.0
    for a, eta, S in zip(dictionary, noise, scatter, strict=True):
        covariance = (a * power) @ a.conj().T + eta * np.eye(len(a))
        value += np.linalg.slogdet(covariance)[1] + np.trace(np.linalg.solve(covariance, S)).real
    return value


def learn(
    dictionary: NDArray,
    scatter: NDArray,
    grid_shape: tuple,
    sources: int,
    sums=column_sums,
    tolerance: float = 1e-4,
    min_iterations: int = 15,
    max_iterations: int = 1000,
) -> Learned:
    """Iterate to convergence from the beamformer's powers."""
    norm = (np.abs(dictionary) ** 2).sum(1)
    output = np.einsum("imc,imn,inc->ic", dictionary.conj(), scatter, dictionary, optimize=True).real
    power = (output / norm**2).mean(0)
    for iteration in range(1, max_iterations + 1):
        noise = residual_noise(dictionary, scatter, strongest_peaks(power, grid_shape, sources))
        top, bottom = sums(dictionary, power, noise, scatter)
        change, power = power, power * top / bottom
        if np.abs(power - change).sum() <= tolerance * power.sum() and iteration >= min_iterations:
            break
    return Learned(power, noise, iteration)
