"""Which groups of parameters leave their nominal values, by forward selection and backward elimination.

A fit is not convex, and what one group lacks another one imitates: a bow looks like other sound speeds, a few
free phases like anything. So groups enter one after another, the one first that explains most beyond what
chance would, and leave again where those that came later make them needless.
"""

import logging
from collections.abc import Callable, Mapping

import torch
from scipy.stats import chi2
from torch import Tensor

from torchdt.calibration.focalise import Focus

log = logging.getLogger(__name__)

_AGAIN = 8
"""Fits around the result of the last one, at most."""

Fit = Callable[[Tensor, Focus | None], Focus]
"""Fit of the parameters that a mask `(T,)` frees, others nominal, from a start; None is what was detected."""


def select(
    fit: Fit, groups: Mapping[str, Tensor], false_alarm: float, kept: tuple[str, ...] = ()
) -> tuple[Focus, tuple[str, ...]]:
    """Fit with the groups that the likelihood asks for.

    Twice the gain of a group that is not needed is distributed as chi-squared with as many degrees of
    freedom as it has parameters, or less for the prior. By chance any of the groups enters with a probability
    of `false_alarm` at most.

    Args:
        fit: see `Fit`.
        groups: masks `(T,)` by name, none of them empty.
        false_alarm: probability of freeing any group where none is needed.
        kept: groups that are free from the start.

    Returns:
        The fit and the names of the groups that are free in it, in the order in which they entered.
    """
    price = {
        name: 0.5 * float(chi2.isf(false_alarm / len(groups), int(mask.sum())))
        for name, mask in groups.items()
    }
    nothing = torch.zeros_like(next(iter(groups.values())))

    def union(names: tuple[str, ...]) -> Tensor:
        return sum((groups[name] for name in names), nothing)

    best = fit(union(kept), None)
    for _ in range(2 * len(groups)):
        tried = {name: fit(union((*kept, name)), best) for name in groups if name not in kept}
        gains = ", ".join(f"{_gain(found, best):.1f} by {name}" for name, found in tried.items())
        log.info("environment fit gains %s, in nats", gains or "nothing more")
        surplus = {name: _gain(found, best) - price[name] for name, found in tried.items()}
        name = max(surplus, key=surplus.__getitem__, default="")
        if not tried or surplus[name] <= 0:
            break
        # A fit may also gain by better positions, which are there for all.
        fair = fit(union(kept), tried[name])
        best = max(best, fair, key=lambda found: float(found.log_posterior))
        if _gain(tried[name], best) > price[name]:
            kept = (*kept, name)
            best = _settled(fit, union(kept), tried[name])
    for name in kept[:-1]:
        others = tuple(other for other in kept if other != name)
        without = fit(union(others), best)
        if _gain(best, without) <= price[name]:
            best, kept = _settled(fit, union(others), without), others
    return best, kept


def _settled(fit: Fit, free: Tensor, start: Focus) -> Focus:
    """Fits again, since fields are right to first order around the start of each."""
    best = start
    for _ in range(_AGAIN):
        before, best = best, fit(free, best)
        if abs(_gain(best, before)) < 1:
            break
    return best


def _gain(more: Focus, less: Focus) -> float:
    return float(more.log_posterior - less.log_posterior)
