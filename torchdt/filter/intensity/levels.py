"""Likelihood of one more object in every cell, at some levels of its power."""

import torch
from torch import Tensor

CEILING = 30.0
"""Of what one tone of one step can say for an object, nats: enough for any belief, and e^30 is a number."""


def level_log_likelihood(s: Tensor, q: Tensor, J: Tensor, power: Tensor, share: Tensor) -> Tensor:
    """Log-likelihood ratio of an object of each level in every cell, `(*batch, L, C)`.

    In each step a tone has one of some powers around the level, or none, whatever it had before:
    `sum_i log(w_0 + sum_g w_g exp ell_i(x, gamma_g))`, with `ell` as in `torchdt.filter.bp.rank_one`.

    Args:
        s, q: `(*batch, I, C)` quadratic forms.
        J: `(*batch, I)` number of snapshots.
        power: `(*batch, I, G)` powers.
        share: `(L, 1 + G)` of no power, and of each power, at every level; rows add up to one.
    """
    batch = torch.broadcast_shapes(s.shape[:-2], power.shape[:-2])
    total = s.new_zeros((*batch, share.shape[0], s.shape[-1]))
    silent, heard = share[:, :1], share[:, 1:]
    for tone in range(s.shape[-2]):
        s_tone, q_tone = s[..., tone, None, :], q[..., tone, None, :]
        gamma, count = power[..., tone, :, None], J[..., tone, None, None]
        gain = gamma * s_tone + 1
        ell = gamma * q_tone / gain - count * gain.log()
        total = total + (heard @ ell.clamp_max(CEILING).exp() + silent).log()
    return total
