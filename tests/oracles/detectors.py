"""Detection by the book, with loops, pseudo-inverses and explicit projections; and a small planar array."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchdt.model.region import Coordinate, Region


class PlanarField:
    """12 sensors at random in a plane, 2 tones; a state is two direction cosines, then their rates.

    Sensors are the more sensitive the closer they are to the direction, so that the norm varies.
    """

    num_tones, num_sensors, num_coordinates = 2, 12, 2

    def __init__(self, dtype: torch.dtype = torch.float64):
        places = np.random.default_rng(3).uniform(0, 45, (12, 2))
        waves = 2 * np.pi * np.array([100.0, 150.0]) / 1500.0
        self.phase = torch.tensor(waves[:, None, None] * places, dtype=dtype)
        self.gain = torch.tensor(places / 20, dtype=dtype)

    def __call__(self, state: Tensor) -> Tensor:
        phase = (self.phase * state[..., None, None, :2]).sum(-1)
        gain = (self.gain * state[..., None, :2]).sum(-1).exp()[..., None, :]
        return torch.complex(gain * phase.cos(), -gain * phase.sin())


def planar_region(dtype: torch.dtype = torch.float64) -> Region:
    """10 x 12 cells, of different sizes."""
    u = Coordinate("u", "", -0.6, 0.6, 0.12, -1, 1, 1.0)
    return Region([u, Coordinate("v", "", -0.6, 0.6, 0.1, -1, 1, 1.0)], dtype)


def off(columns: NDArray) -> NDArray:
    """Projection on what is orthogonal to columns (M, Q)."""
    return np.eye(len(columns)) - columns @ np.linalg.pinv(columns)


def matching_pursuit(
    response: NDArray, snapshots: NDArray, grid: NDArray, number: int, separation: float, threshold: float
) -> list[int]:
    """Cells in order of picking; response (I, C, M), snapshots (I, J, M), grid (C, d) in cells."""
    _, num_snapshots, num_sensors = snapshots.shape
    picks: list[int] = []
    while len(picks) < number:
        best, best_score = -1, threshold
        for cell in range(len(grid)):
            if any((np.abs(grid[cell] - grid[pick]) < separation - 0.01).all() for pick in picks):
                continue
            score = 0.0
            for a, z in zip(response, snapshots, strict=True):
                left = off(a[picks].T) @ z.T if picks else z.T
                noise = np.linalg.norm(left) ** 2 / (num_snapshots * (num_sensors - len(picks)))
                matched = np.linalg.norm(a[cell].conj() @ left) ** 2 / np.linalg.norm(a[cell]) ** 2
                x = max(matched / (noise * num_snapshots), 1.0)
                score += num_snapshots * (x - 1 - np.log(x))
            if score > best_score:
                best, best_score = cell, score
        if best < 0:
            return picks
        picks.append(best)
    return picks


def describe_points(points: NDArray, snapshots: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Power (Q, I), noise (I,) and share of what the others leave (Q, I) of points (Q, I, M)."""
    number, num_tones, num_sensors = points.shape
    num_snapshots = snapshots.shape[1]
    power, share, noise = np.zeros((number, num_tones)), np.zeros((number, num_tones)), np.zeros(num_tones)
    for i in range(num_tones):
        A, z = points[:, i].T, snapshots[i].T
        power[:, i] = (np.abs(np.linalg.pinv(A) @ z) ** 2).mean(-1)
        noise[i] = np.linalg.norm(off(A) @ z) ** 2 / (num_snapshots * (num_sensors - number))
        for n in range(number):
            P = off(np.delete(A, n, 1))
            a, left = P @ A[:, n], P @ z
            matched = np.linalg.norm(a.conj() @ left) / np.linalg.norm(a) / np.linalg.norm(left)
            share[n, i] = matched**2
    return power, noise, share
