"""Birth of new objects: a Poisson process over the cells of the region (Liang and Meyer, Sec. II-B)."""

import torch
from torch import Tensor


def birth_log_odds(birth_mean: Tensor, num_cells: int) -> Tensor:
    """Log-odds of a new object in one cell: `p = mu / (mu + 1)` with `mu = mu_B / Q`, so `log mu`.

    Args:
        birth_mean: mu_B, `(*batch,)` positive.
        num_cells: Q.
    """
    return torch.log(birth_mean / num_cells)


def log_no_birth(birth_mean: Tensor, num_cells: int, num_considered: Tensor) -> Tensor:
    """Log-probability that nothing is born in the cells that are not looked at: `-(Q - n) log(1 + mu)`.

    Args:
        birth_mean: mu_B, `(*batch,)` positive.
        num_cells: Q.
        num_considered: n, `(*batch,)` number of cells in which a new object is considered.
    """
    return (num_considered - num_cells) * torch.log1p(birth_mean / num_cells)
