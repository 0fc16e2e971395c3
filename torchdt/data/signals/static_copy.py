"""A second, standing source made from the data of a moving one (Liang and Meyer, Sec. V)."""

import torch
from torch import Tensor

from torchdt.core.errors import require


def add_static_copy(
    snapshots: Tensor, truth: Tensor | None, step: int, gain_db: float
) -> tuple[Tensor, Tensor | None]:
    """Add the snapshots of one step to all steps: `z_k <- 10^(gain_db / 20) z_k + z_step`.

    Args:
        snapshots: `(K, I, J, M)` complex.
        truth: `(K, L, d)`, NaN = absent, or None.
        step: from 0; its sources stand still in the copy.
        gain_db: of what was there before, dB; -3 leaves a moving source 3 dB weaker than its copy, as far as
            its level stays what it was at `step`.

    Returns:
        Snapshots, and truth `(K, 2 L, d)` with the copies after what was there before.

    Raises:
        InputError: where there is no such step.
    """
    require(0 <= step < len(snapshots), "data.static_copy.step", step, f"0 to {len(snapshots) - 1}")
    both = 10 ** (gain_db / 20) * snapshots + snapshots[step]
    return both, None if truth is None else torch.cat([truth, truth[step].expand_as(truth)], 1)
