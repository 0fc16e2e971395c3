"""Which object a point comes from: loopy belief propagation on the association graph.

J. L. Williams and R. A. Lau, "Approximate evaluation of marginal association probabilities with belief
propagation", IEEE Trans. Aerosp. Electron. Syst. 50, 2014, in the notation of Meyer et al., "Message passing
algorithms for scalable multitarget tracking", Proc. IEEE 106, 2018, Sec. IX. Object n takes point a_n = m or
none (a_n = 0), and no two objects take the same point:

    p(a) ~ prod_n beta_n(a_n) prod_{m taken by none} xi_m

It converges to the only fixed point there is, and is exact where there is only one object or only one point.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Messages(NamedTuple):
    """Messages at the fixed point, natural logarithms.

    Attributes:
        to_object: `(*batch, N, M)` log v_{m -> n}: whether point m is free for object n.
        to_new: `(*batch, M)` log sum_n phi_{n -> m}: whether the known objects claim point m.
    """

    to_object: Tensor
    to_new: Tensor


def associate(legacy: Tensor, new: Tensor, tolerance: float, iterations: int) -> Messages:
    """Iterate the messages between known objects and points.

    `phi_{n->m} = beta_n(m) / (beta_n(0) + sum_{m' != m} beta_n(m') v_{m'->n})` and
    `v_{m->n} = 1 / (xi_m + sum_{n' != n} phi_{n'->m})`, all in logarithms. A batch element that has converged
    stands still, so it does not depend on the others.

    Args:
        legacy: `(*batch, N, 1 + M)` log beta_n(0), finite, then log beta_n(m); minus infinity for a point or
            an object that is not there.
        new: `(*batch, M)` log xi_m, finite: what a point weighs that no known object takes.
        tolerance: largest change of a message at which the iteration stops, nats.
        iterations: their largest number.
    """
    missed, taken = legacy[..., 0], legacy[..., 1:]
    to_object = (-new.unsqueeze(-2)).expand_as(taken)
    moving = torch.ones(new.shape[:-1], dtype=torch.bool, device=new.device)
    for _ in range(iterations):
        claims = _claims(missed, taken, to_object)
        updated = -_instead_of_own(new, claims.mT).mT
        change = (updated - to_object).abs().flatten(-2)
        to_object = torch.where(moving[..., None, None], updated, to_object)
        moving = moving & (change > tolerance).any(-1)
        if not bool(moving.any()):
            break
    return Messages(to_object, _claims(missed, taken, to_object).logsumexp(-2))


def association_probabilities(legacy: Tensor, messages: Messages) -> Tensor:
    """Marginals p(a_n = m), `(*batch, N, 1 + M)`; the first column is that of no point.

    Args:
        legacy: as given to `associate`.
        messages: its result.
    """
    belief = torch.cat([legacy[..., :1], legacy[..., 1:] + messages.to_object], -1)
    return belief.softmax(-1)


def _claims(missed: Tensor, taken: Tensor, to_object: Tensor) -> Tensor:
    """Messages log phi_{n -> m}, `(*batch, N, M)`."""
    return taken - _instead_of_own(missed, taken + to_object)


def _instead_of_own(base: Tensor, terms: Tensor) -> Tensor:
    """`log(e^base + sum_{j' != j} e^terms_j')` for every j: `(*batch,)` and `(*batch, J)` to `(*batch, J)`.

    Summed anew for every j: what a subtraction from the whole sum leaves is rounding where one term outweighs
    the others.
    """
    own = torch.eye(terms.shape[-1], dtype=torch.bool, device=terms.device)
    return torch.where(own, base[..., None, None], terms.unsqueeze(-2)).logsumexp(-1)
