"""Generalized optimal sub-pattern assignment (GOSPA) metric.

A. S. Rahmathullah, A. F. Garcia-Fernandez and L. Svensson, "Generalized optimal sub-pattern assignment
metric", FUSION 2017.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.model.distance import EUCLIDEAN, Distance, distances


class Gospa(NamedTuple):
    """GOSPA and its parts, each `(*batch,)`.

    The parts are sums of p-th powers: `total ** p = localisation + missed + false`. So they add up to the
    total for p = 1 only.

    Attributes:
        total: the metric, in the unit of the distance, float64.
        localisation: sum of `d ** p` over the assigned pairs, float64.
        missed: `c ** p / 2` per missed object, float64.
        false: `c ** p / 2` per false estimate, float64.
        num_truth: true objects, int64.
        num_estimated: estimates, int64.
    """

    total: Tensor
    localisation: Tensor
    missed: Tensor
    false: Tensor
    num_truth: Tensor
    num_estimated: Tensor

    def select(self, run: int) -> "Gospa":
        """One element of the leading batch dimension, `(K,)` for a batch `(B, K)`."""
        return Gospa(*(field[run] for field in self))


def gospa(
    estimates: Tensor,
    estimate_mask: Tensor,
    truth: Tensor,
    truth_mask: Tensor,
    cutoff: float,
    order: float = 1.0,
    distance: Distance = EUCLIDEAN,
) -> Gospa:
    """Compare sets of estimates with sets of true positions, with alpha = 2.

    Proposition 1 of the paper: the minimum over assignments of
    `sum over pairs d(x, y)^p + c^p / 2 (number missed + number false)`, to the power 1/p.
    A pair at or beyond the cutoff costs as much as one missed and one false and is counted as these.

    Args:
        estimates: `(*batch, N, d)` estimated positions; N may be zero.
        estimate_mask: `(*batch, N)` bool, which of them count.
        truth: `(*batch, L, d)` true positions; L may be zero.
        truth_mask: `(*batch, L)` bool, which of them exist. Masked entries may hold anything.
        cutoff: c > 0, in the unit of the distance.
        order: p >= 1.
        distance: d.

    Returns:
        The metric for each element of the batch, on the device of `estimates`, without gradient.

    Raises:
        InputError: shapes that do not fit, a cutoff or order out of range, a position that is not finite.
    """
    _check(estimates, estimate_mask, truth, truth_mask, cutoff, order)
    batch = estimates.shape[:-2]
    x, x_mask = _flat(estimates, 2), _flat(estimate_mask, 1)
    y, y_mask = _flat(truth, 2), _flat(truth_mask, 1)

    rows = [_one(x[b][x_mask[b]], y[b][y_mask[b]], cutoff, order, distance) for b in range(math.prod(batch))]
    table = torch.tensor(rows, dtype=torch.float64, device=estimates.device).reshape(*batch, 6)
    total, localisation, missed, false, num_truth, num_estimated = table.unbind(-1)
    return Gospa(total, localisation, missed, false, num_truth.long(), num_estimated.long())


def _one(x: Tensor, y: Tensor, cutoff: float, order: float, distance: Distance) -> tuple[float, ...]:
    apart = distances(x, y, distance).numpy()
    cost = np.minimum(apart, cutoff) ** order
    i, j = linear_sum_assignment(cost)
    paired = apart[i, j] < cutoff

    localisation = float(cost[i, j][paired].sum())
    missed = (len(y) - paired.sum()) * cutoff**order / 2
    false = (len(x) - paired.sum()) * cutoff**order / 2
    total = (localisation + missed + false) ** (1 / order)
    return total, localisation, missed, false, len(y), len(x)


def _flat(values: Tensor, trailing: int) -> Tensor:
    """Merge the batch dimensions into one; the product is written out because a set may be empty."""
    values = values.detach().cpu()
    values = values if values.dtype == torch.bool else values.double()
    split = values.ndim - trailing
    return values.reshape(math.prod(values.shape[:split]), *values.shape[split:])


def _check(
    estimates: Tensor, estimate_mask: Tensor, truth: Tensor, truth_mask: Tensor, cutoff: float, order: float
) -> None:
    if not (math.isfinite(cutoff) and cutoff > 0):
        raise InputError.of_key("cutoff", cutoff, "a finite number above zero")
    if not (math.isfinite(order) and order >= 1):
        raise InputError.of_key("order", order, "a finite number, at least one")
    if estimates.dim() < 2:
        raise InputError.of_key("estimates", f"shape {tuple(estimates.shape)}", "(*batch, N, d)")
    *batch, _, dim = estimates.shape
    if truth.dim() < 2 or list(truth.shape[:-2]) != batch or truth.shape[-1] != dim:
        wanted = ", ".join([*map(str, batch), "L", str(dim)])
        raise InputError.of_key("truth", f"shape {tuple(truth.shape)}", f"({wanted}), as the estimates")
    for key, mask, values in (
        ("estimate_mask", estimate_mask, estimates),
        ("truth_mask", truth_mask, truth),
    ):
        if mask.dtype != torch.bool or mask.shape != values.shape[:-1]:
            found = f"{mask.dtype} of shape {tuple(mask.shape)}"
            raise InputError.of_key(key, found, f"torch.bool of shape {tuple(values.shape[:-1])}")
        if not values[mask].isfinite().all():
            raise InputError.of_key(key, "a position that is not finite", "finite positions where true")
