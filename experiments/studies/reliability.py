"""Whether existence can be trusted: of the objects that exist with some probability, that share exists."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from rich.console import Console
from rich.table import Table
from scipy.stats import binom
from torch import Tensor

from torchdt.filter.history import TrackHistory
from torchdt.model.distance import Distance, distances
from torchdt.simulation.settings import PopulationSettings

ALARM = 1e-5
"""Probability with which a tenth of a filter that is right lies outside its limits, at most."""


class Tenth(NamedTuple):
    """Potential objects of one tenth of existence.

    Attributes:
        low: where the tenth begins.
        number: of potential objects.
        expected: their mean existence; NaN for none.
        exist: how many of them are true ones.
        limits: fewest and most that are expected, at `ALARM`.
    """

    low: float
    number: int
    expected: float
    exist: int
    limits: tuple[int, int]

    @property
    def holds(self) -> bool:
        """Whether as many exist as are said to."""
        return self.limits[0] <= self.exist <= self.limits[1]


def tenths(existence: Tensor, exists: Tensor) -> list[Tenth]:
    """Count by tenths of the probability of existence.

    The number that exists is a sum of draws of different probabilities. A binomial one of their mean spreads
    more (Hoeffding, Ann. Math. Stat. 1956), so its limits are not too narrow.

    Args:
        existence: `(n,)` probabilities of objects that have nothing to do with each other.
        exists: `(n,)` bool, the truth.
    """
    rows = []
    for tenth in range(10):
        # The last one includes certainty.
        inside = (10 * existence).long().clamp_max(9) == tenth
        number, mean = int(inside.sum()), float(existence[inside].mean())
        ends = (binom.ppf(p, number, mean) if number else 0 for p in (ALARM / 2, 1 - ALARM / 2))
        low, high = (int(end) for end in ends)
        rows.append(Tenth(tenth / 10, number, mean, int((inside & exists).sum()), (low, high)))
    return rows


def potential_objects(
    history: TrackHistory, truth: Tensor, steps: Sequence[int], cutoff: float, distance: Distance
) -> tuple[Tensor, Tensor]:
    """Existence of all potential objects, declared or not, and whether they are true ones.

    Args:
        history: batch `(B,)`, on the CPU.
        truth: `(B, K, L, d)` float64 true positions, NaN while absent.
        steps: at which they are looked at, far enough from each other.
        cutoff: distance below which a potential object may be a true one.
        distance: of an estimate and a true position.

    Returns:
        `(n,)` float64 and `(n,)` bool.
    """
    pairs = [
        pair
        for existence, position, there in zip(
            history.existence[:, steps].double().flatten(0, 1),
            history.position[:, steps].double().flatten(0, 1),
            truth[:, steps].flatten(0, 1),
            strict=True,
        )
        for pair in _claims(existence, distances(position, there, distance) < cutoff)
    ]
    existence, exists = zip(*pairs, strict=True) if pairs else ((), ())
    return torch.tensor(existence, dtype=torch.float64), torch.tensor(exists, dtype=torch.bool)


def _claims(existence: Tensor, near: Tensor) -> Iterator[tuple[float, bool]]:
    """Existence and truth in one step: a true object is one potential object, the most probable near it.

    Args:
        existence: `(N,)`, zero for an empty slot.
        near: `(N, L)` bool.
    """
    free = torch.ones_like(near[0])
    for slot in existence.argsort(descending=True).tolist():
        if existence[slot] > 0:
            claimed = (near[slot] & free).nonzero()[:1, 0]
            free[claimed] = False
            yield float(existence[slot]), len(claimed) > 0


def model_of(population: PopulationSettings) -> list[str]:
    """Overrides with which the direct tracker assumes what a population is drawn from."""
    return [
        f"model.birth.birth_mean={population.birth_mean}",
        f"model.survival={population.survival}",
        f"model.power.power_shape={population.power_shape}",
        f"model.noise.noise_shape={population.noise_shape}",
        f"tracker.power_max={10 ** (population.power_db[1] / 10)}",
    ]


def print_tenths(console: Console, rows: Sequence[Tenth]) -> None:
    """Print the shares beside their limits."""
    table = Table("existence", "objects", "mean existence", "exist", "share", f"limits at {ALARM:g}", "")
    for row in rows:
        share = "-" if not row.number else f"{row.exist / row.number:.3f}"
        mean = "-" if not row.number else f"{row.expected:.3f}"
        limits = f"{row.limits[0]} - {row.limits[1]}"
        cells = (f"{row.low:.1f} - {row.low + 0.1:.1f}", f"{row.number}", mean, f"{row.exist}", share, limits)
        table.add_row(*cells, "" if row.holds else "outside")
    console.print(table)
