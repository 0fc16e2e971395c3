"""Exact marginals of the association of points to objects, by enumeration."""

import torch
from torch import Tensor
from torch.nn.functional import one_hot


def enumerate_associations(legacy: Tensor, new: Tensor) -> tuple[Tensor, Tensor]:
    """Sum over all ways in which no two objects take the same point.

    Args:
        legacy: `(N, 1 + M)` log-weight of no point and of each point, for each object.
        new: `(M,)` log-weight of a point that none takes.

    Returns:
        p(a_n = m) `(N, 1 + M)`, and the probability `(M,)` that no object takes a point.
    """
    num, choices = legacy.shape
    joint = torch.cartesian_prod(*[torch.arange(choices)] * num).reshape(-1, num)
    taken = one_hot(joint, choices)  # (A, N, 1 + M)
    times = taken[..., 1:].sum(1)
    joint, taken, times = (t[(times <= 1).all(-1)] for t in (joint, taken, times))
    log_weight = legacy[torch.arange(num), joint].sum(-1)
    log_weight = log_weight + torch.where(times == 0, new, 0.0).sum(-1)
    weight = log_weight.softmax(0)
    return (weight[:, None, None] * taken).sum(0), weight @ (times == 0).to(weight)
