"""Moment matching: every object as a zero-mean complex Gaussian for the others."""

import torch
from torch import Tensor


def response_moment(response: Tensor, log_weight: Tensor) -> Tensor:
    """`E[a a^H]` of a particle set.

    Args:
        response: `(*batch, I, P, M)` complex.
        log_weight: `(*batch, P)` normalised.

    Returns:
        `(*batch, I, M, M)` complex Hermitian.
    """
    return weighted_moment(response, log_weight.exp())


def weighted_moment(response: Tensor, weight: Tensor) -> Tensor:
    """`sum_p w_p a_p a_p^H`.

    Args:
        response: `(*batch, I, P, M)` complex.
        weight: `(*batch, P)` real.

    Returns:
        `(*batch, I, M, M)` complex Hermitian.
    """
    # In real numbers: a complex product of this shape is slower. [Re, Im] in turn, so 2 M columns.
    parts = torch.view_as_real(response).flatten(-2)
    products = parts.mT @ (parts * weight[..., None, :, None])
    re_re, re_im, im_re, im_im = (products[..., i::2, j::2] for i in (0, 1) for j in (0, 1))
    return torch.complex(re_re + im_im, im_re - re_im)


def signal_covariance(strength: Tensor, moment: Tensor) -> Tensor:
    """`sum_n r_n E[gamma_n] E[a_n a_n^H]`.

    Args:
        strength: `(*batch, N, I)` real, `r_n E[gamma_n]`; zero leaves an object out.
        moment: `(*batch, N, I, M, M)` complex.

    Returns:
        `(*batch, I, M, M)` complex Hermitian.
    """
    return (strength[..., None, None] * moment).sum(-4)


def without(strength: Tensor, index: Tensor) -> Tensor:
    """Zero the strength of one object per batch element.

    Args:
        strength: `(*batch, N, I)`.
        index: `(*batch,)` int64.
    """
    slots = torch.arange(strength.shape[-2], device=strength.device)
    return torch.where((slots == index[..., None])[..., None], 0.0, strength)


def signal_without_each(strength: Tensor, moment: Tensor) -> Tensor:
    """For every object, the signal covariance of all others.

    Args:
        strength: `(*batch, N, I)` real.
        moment: `(*batch, N, I, M, M)` complex.

    Returns:
        `(*batch, N, I, M, M)` complex Hermitian.
    """
    num = strength.shape[-2]
    others = 1 - torch.eye(num, dtype=moment.dtype, device=moment.device)
    return torch.einsum("nm,...mikl->...nikl", others, strength[..., None, None] * moment)
