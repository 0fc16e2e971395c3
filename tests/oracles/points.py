"""Objects that move in a rectangle, and the points found of them."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from torchdt.baselines.detect.points import Points
from torchdt.model.region import Coordinate, Region

CAPACITY = 12


class Path(NamedTuple):
    """An object from one step to before another, at a constant rate."""

    first: int
    last: int
    start: tuple[float, float]
    rate: tuple[float, float]


def make_region(dtype: torch.dtype = torch.float64) -> Region:
    """1000 m x 500 m."""
    return Region(
        [
            Coordinate("x", "m", 0.0, 1000.0, 20.0, -10.0, 10.0, 0.05),
            Coordinate("y", "m", -100.0, 400.0, 10.0, -5.0, 5.0, 0.05),
        ],
        dtype,
    )


def true_positions(steps: int, paths: Sequence[Path]) -> Tensor:
    """`(K, L, 2)`, NaN where an object is absent."""
    truth = torch.full((steps, len(paths), 2), torch.nan, dtype=torch.float64)
    for n, path in enumerate(paths):
        time = torch.arange(path.last - path.first, dtype=torch.float64)[:, None]
        start, rate = (torch.tensor(v, dtype=torch.float64) for v in (path.start, path.rate))
        truth[path.first : path.last, n] = start + time * rate
    return truth


def make_points(positions: Sequence[Tensor], powers: Sequence[Tensor], dtype: torch.dtype) -> Points:
    """Points of K steps from `(M_k, d)` positions and `(M_k,)` powers of the one tone, with padding."""
    steps, d = len(positions), positions[0].shape[-1]
    position, power = (
        torch.zeros(steps, CAPACITY, d, dtype=dtype),
        torch.zeros(steps, CAPACITY, 1, dtype=dtype),
    )
    present = torch.zeros(steps, CAPACITY, dtype=torch.bool)
    for k, (where, strength) in enumerate(zip(positions, powers, strict=True)):
        position[k, : len(where)], power[k, : len(where), 0] = where.to(dtype), strength.to(dtype)
        present[k, : len(where)] = True
    return Points(position, present.to(dtype), power, present, torch.full((steps, 1), 0.5, dtype=dtype))


def no_points(steps: int, dtype: torch.dtype = torch.float64) -> Points:
    return make_points([torch.zeros(0, 2)] * steps, [torch.zeros(0)] * steps, dtype)


def batch_of_one(points: Points) -> Points:
    return Points(*(t[None] for t in points))


def stacked(points: Sequence[Points]) -> Points:
    return Points(*(torch.stack(parts) for parts in zip(*points, strict=True)))


def simulate(
    seed: int,
    truth: Tensor,
    *,
    spread: Sequence[float],
    detection_probability: float,
    clutter_mean: float,
    dtype: torch.dtype = torch.float64,
) -> Points:
    """Points of `(K, L, 2)` objects in the region, in random order; object n has power n + 1, clutter 0."""
    rng = Generator().manual_seed(seed)
    region, positions, powers = make_region(), [], []
    for objects in truth:
        seen = torch.rand(len(objects), generator=rng) < detection_probability
        seen = seen & objects[:, 0].isfinite()
        found = objects[seen] + torch.tensor(spread) * torch.randn(int(seen.sum()), 2, generator=rng)
        number = int(torch.poisson(torch.tensor(clutter_mean), generator=rng))
        false = torch.lerp(region.low, region.high, torch.rand(number, 2, generator=rng, dtype=torch.float64))
        order = torch.randperm(len(found) + number, generator=rng)[:CAPACITY]
        positions.append(torch.cat([found, false])[order])
        powers.append(torch.cat([seen.nonzero()[:, 0] + 1, torch.zeros(number)])[order])
    return make_points(positions, powers, dtype)
