"""GOSPA for sets of trajectories (T-GOSPA), by linear programming.

A. F. Garcia-Fernandez, A. S. Rahmathullah and L. Svensson, "A metric on the space of finite sets of
trajectories for evaluation of multi-target tracking algorithms", IEEE Trans. Signal Process., vol. 68, 2020.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, eye_array, hstack, kron, vstack
from scipy.sparse.csgraph import connected_components

from torchdt.core.errors import require
from torchdt.filter.history import TrackHistory
from torchdt.model.distance import EUCLIDEAN, Distance, distances

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class TGospa(NamedTuple):
    """T-GOSPA and its parts.

    The parts are sums of p-th powers over all steps: `total ** p = localisation + missed + false + switch`.

    Attributes:
        total: the metric, in the unit of the distance.
        localisation: sum of `d ** p` over the assigned pairs nearer than the cutoff.
        missed: `c ** p / 2` per step and true object without estimate.
        false: `c ** p / 2` per step and estimate without true object.
        switch: `gamma ** p` per switch of the assignment.
        num_switches: number of switches; one to or from no assignment counts half.
    """

    total: float
    localisation: float
    missed: float
    false: float
    switch: float
    num_switches: float


def tgospa(
    truth: ArrayLike,
    estimates: ArrayLike,
    cutoff: float,
    switch_cost: float,
    order: float = 1.0,
    distance: Distance = EUCLIDEAN,
) -> TGospa:
    """Compare two sets of trajectories.

    The linear programming metric of the paper (Sec. IV): the minimum of

        `sum_k sum_ij D_ij(k) w_ij(k) + gamma^p / 2 sum_k sum_ij |w_ij(k + 1) - w_ij(k)|`

    over assignments w between 0 and 1 of all trajectories at each step, to the power 1/p.

    Args:
        truth: `(K, L, d)` true positions, NaN where a trajectory is absent; holes are allowed.
        estimates: `(K, N, d)` estimated positions by label, NaN where absent.
        cutoff: c > 0, in the unit of the distance.
        switch_cost: gamma >= 0, in the same unit.
        order: p >= 1.
        distance: of an estimate and a true position.

    Raises:
        InputError: shapes that do not fit, or a parameter out of range.
    """
    x, y = np.asarray(truth, np.float64), np.asarray(estimates, np.float64)
    _check(x, y, cutoff, switch_cost, order)
    x_here, y_here = np.all(np.isfinite(x), axis=-1), np.all(np.isfinite(y), axis=-1)
    unit, gamma = cutoff**order / 2, switch_cost**order

    # Unassigned trajectories cost `unit` a step. An assigned pair costs less by its worth, which is zero
    # unless both are present and nearer than c. Pairs never worth anything need no assignment, which keeps
    # the program small however many tracks there are.
    both = x_here[:, :, None] & y_here[:, None, :]
    there, found = (torch.from_numpy(np.ascontiguousarray(points)) for points in (x, y))
    apart = np.where(both, distances(there, found, distance).numpy(), np.inf)
    worth = 2 * unit - np.minimum(apart, cutoff) ** order
    rows, columns = worth.any(0).nonzero()

    localisation = paired = switches = 0.0
    for pairs in _clusters(rows, columns):
        value = worth[:, rows[pairs], columns[pairs]]
        # Where no pair is worth anything the assignment may stay as it was: such steps are left out.
        value = value[value.any(-1)]
        share = _assign(value, rows[pairs], columns[pairs], gamma)
        near = share * (value > 0)
        localisation += float((near * (2 * unit - value)).sum())
        paired += float(near.sum())
        switches += 0.5 * float(np.abs(np.diff(share, axis=0)).sum())
    missed, false = unit * (float(x_here.sum()) - paired), unit * (float(y_here.sum()) - paired)
    total = (localisation + missed + false + gamma * switches) ** (1 / order)
    return TGospa(total, localisation, missed, false, gamma * switches, switches)


def trajectories(history: TrackHistory) -> Floats:
    """Declared positions by label.

    Args:
        history: of one run, without batch.

    Returns:
        `(K, N, d)` float64, one column for each label that is ever declared, NaN where it is not.
    """
    steps, slots = history.declared.nonzero(as_tuple=True)
    labels, column = history.label[steps, slots].unique(return_inverse=True)
    position = history.position.double().cpu().numpy()
    tracks = np.full((len(position), len(labels), position.shape[-1]), np.nan)
    tracks[steps.cpu(), column.cpu()] = position[steps.cpu(), slots.cpu()]
    return tracks


def _clusters(rows: Indices, columns: Indices) -> Iterator[Indices]:
    """Sets of pairs that share no trajectory with another set (the paper's Sec. IV-D)."""
    if not len(rows):
        return
    shift = rows.max() + 1
    size = shift + columns.max() + 1
    graph = csr_array((np.ones(len(rows)), (rows, columns + shift)), shape=(size, size))
    _, member = connected_components(graph, directed=False)
    for label in np.unique(member[rows]):
        yield (member[rows] == label).nonzero()[0]


def _assign(worth: Floats, rows: Indices, columns: Indices, gamma: float) -> Floats:
    """Best shares `(K, P)` of P pairs of trajectories, worth `(K, P)`.

    With the rises `h(k) >= w(k + 1) - w(k)`, `h >= 0`, the total variation of w is
    `2 sum_k h(k) + w(1) - w(K)`, which saves half of the paper's constraints.
    """
    num_steps, num_pairs = worth.shape
    if num_pairs == 1:
        return np.ones_like(worth)
    ends = np.zeros_like(worth)
    ends[0] += gamma / 2
    ends[-1] -= gamma / 2
    cost = np.concatenate([(ends - worth).ravel(), np.full((num_steps - 1) * num_pairs, gamma)])

    incidence = np.concatenate(
        [rows == i for i in np.unique(rows)] + [columns == j for j in np.unique(columns)]
    )
    incidence = incidence.reshape(-1, num_pairs)
    crowded = csr_array(incidence[incidence.sum(1) > 1].astype(np.float64))
    once = kron(eye_array(num_steps), crowded)
    change = eye_array(num_steps - 1, num_steps, k=1) - eye_array(num_steps - 1, num_steps)
    rise = kron(change, eye_array(num_pairs))
    none = csr_array((once.shape[0], rise.shape[0]))
    matrix = vstack([hstack([once, none]), hstack([rise, -eye_array(rise.shape[0])])], format="csr")
    limit = np.concatenate([np.ones(once.shape[0]), np.zeros(rise.shape[0])])

    solution = linprog(cost, A_ub=matrix, b_ub=limit, bounds=(0, 1), method="highs")
    assert solution.success, solution.message
    return solution.x[: worth.size].reshape(worth.shape)


def _check(x: Floats, y: Floats, cutoff: float, switch_cost: float, order: float) -> None:
    require(math.isfinite(cutoff) and cutoff > 0, "cutoff", cutoff, "a finite number above zero")
    require(
        math.isfinite(switch_cost) and switch_cost >= 0, "switch_cost", switch_cost, "a number from zero up"
    )
    require(math.isfinite(order) and order >= 1, "order", order, "a finite number, at least one")
    require(x.ndim == 3, "truth", f"shape {x.shape}", "(K, L, d)")
    fits = y.ndim == 3 and (y.shape[0], y.shape[2]) == (x.shape[0], x.shape[2])
    require(fits, "estimates", f"shape {y.shape}", f"({x.shape[0]}, N, {x.shape[2]}), as the truth")
    for key, value in (("truth", x), ("estimates", y)):
        require(not np.isinf(value).any(), key, "a position that is infinite", "finite positions, or NaN")
