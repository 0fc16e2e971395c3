"""Likelihood ratio of one more object: a rank-one update of the covariance.

With everything else moment-matched to `CN(0, Sigma)`, an object of response `a` and power `gamma`
changes the log-likelihood of J snapshots with scatter matrix `S = B B^H` by

    ell(x, gamma) = -J log(1 + gamma s) + gamma q / (1 + gamma s),
    s = a^H Sigma^-1 a,   q = a^H Sigma^-1 S Sigma^-1 a,

by the matrix determinant lemma and the Sherman-Morrison formula. One Cholesky factorisation serves all
particles of an object.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.linalg import cholesky
from torchdt.model.measurement import Measurement


class Whitener(NamedTuple):
    """What a background leaves to be done per particle, per tone.

    Attributes:
        projection: `(*batch, I, M, M + R)` complex, `[L^-H, Sigma^-1 B]` with `Sigma = L L^H`; rows of
            missing sensors are zero, so a response needs no mask of its own.
        num_snapshots: `(*batch, I)` real J.
    """

    projection: Tensor
    num_snapshots: Tensor


def whiten(measurement: Measurement, background: Tensor) -> Whitener:
    """Factorise a background covariance.

    Args:
        measurement: statistics of one step, batch `(*batch,)`.
        background: Sigma, `(*batch, I, M, M)` complex.

    Raises:
        NumericalError: where Sigma is not positive definite.
    """
    # Objects 30-40 dB above the noise make Sigma ill-conditioned for single precision. The few small
    # matrices are factorised in double; what multiplies the many particles is single again.
    lower = cholesky(background.to(torch.complex128), "background covariance")
    eye = torch.eye(lower.shape[-1], dtype=lower.dtype, device=lower.device)
    inverse = torch.linalg.solve_triangular(lower, eye, upper=False)
    spread = inverse.mH @ (inverse @ measurement.factor.to(lower.dtype))
    projection = torch.cat([inverse.mH, spread], dim=-1) * measurement.present[..., None]
    return Whitener(projection.to(background.dtype), measurement.num_snapshots)


def statistics(whitener: Whitener, response: Tensor) -> tuple[Tensor, Tensor]:
    """The quadratic forms s and q of every particle.

    Args:
        whitener: of batch `(*batch,)`.
        response: `(*batch, I, P, M)` complex responses a.

    Returns:
        s and q, `(*batch, I, P)` real, s >= 0, q >= 0.
    """
    # a^H [L^-H, Sigma^-1 B]; the conjugate moves to the small factor, |.|^2 does not see it.
    parts = torch.view_as_real(response @ whitener.projection.conj().resolve_conj()).flatten(-2)
    s, q = parts.tensor_split([2 * response.shape[-1]], dim=-1)
    # A norm is one pass over the largest tensor of all; squares and their sum are three.
    return torch.linalg.vector_norm(s, dim=-1).square(), torch.linalg.vector_norm(q, dim=-1).square()


def log_likelihood_ratio(J: Tensor, power: Tensor, s: Tensor, q: Tensor) -> Tensor:
    """`ell(x, gamma)`, all arguments broadcast against each other.

    Args:
        J: number of snapshots.
        power: gamma >= 0.
        s, q: quadratic forms from `statistics`.
    """
    gain = power * s
    return power * q / (1 + gain) - J * torch.log1p(gain)


def peak_log_likelihood_ratio(J: Tensor, s: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Maximum of `ell` over the power and the power that reaches it.

    `gamma = max(0, q / J - s) / s^2` (Tipping and Faul, AISTATS 2003).

    Returns:
        The maximum, >= 0, and gamma, >= 0, both of the broadcast shape.
    """
    tiny = torch.finfo(s.dtype).tiny
    safe_s, safe_J = s.clamp_min(tiny), J.clamp_min(tiny)
    ratio = (q / (safe_J * safe_s)).clamp_min(1.0)
    heard = (J > 0) & (s > tiny)
    peak = torch.where(heard, J * (ratio - 1 - ratio.log()), 0.0)
    return peak, torch.where(heard, (ratio - 1) / safe_s, 0.0)
