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

from torchdt.core.linalg import cholesky
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
    squares = squared_products(whitener.projection, response)
    s, q = squares.tensor_split([2 * response.shape[-1]], dim=-2)
    return s.sum(-2), q.sum(-2)


def squared_products(columns: Tensor, response: Tensor) -> Tensor:
    """Squared real and imaginary parts of `w^H a`, in turn, for every column w and response a.

    Args:
        columns: `(*batch, I, M, W)` complex.
        response: `(*batch, I, P, M)` complex.

    Returns:
        `(*batch, I, 2 W, P)` real: particles come last, so that sums over columns are those of long rows.
    """
    # In real numbers: the rows are the parts of conj(w) and i conj(w), which multiply those of a.
    conjugate = columns.conj()
    weights = torch.view_as_real(torch.stack([conjugate, 1j * conjugate], dim=-2)).flatten(-2).flatten(-3, -2)
    return (weights.mT @ torch.view_as_real(response).flatten(-2).mT).square()


def log_likelihood_ratio(
    J: Tensor, power: Tensor, s: Tensor, q: Tensor, log_weight: Tensor | float = 0.0
) -> Tensor:
    """`ell(x, gamma)` plus a log-weight, in the broadcast shape of powers and quadratic forms.

    Args:
        J: number of snapshots.
        power: gamma >= 0.
        s, q: quadratic forms from `statistics`.
        log_weight: of the power, say.
    """
    # In place where possible: these are the largest tensors of all, and fresh memory costs more than sums.
    gain = power * s
    fit = (power * q).div_(gain + 1)
    return gain.log1p().mul_(-J).add_(log_weight).add_(fit)


def peak_log_likelihood_ratio(J: Tensor, s: Tensor, q: Tensor) -> tuple[Tensor, Tensor]:
    """Maximum of `ell` over the power and the power that reaches it.

    `gamma = max(0, q / J - s) / s^2` (Tipping and Faul, AISTATS 2003).

    Returns:
        The maximum, >= 0, and gamma, >= 0, both of the broadcast shape.
    """
    tiny = torch.finfo(s.dtype).tiny
    safe_s, safe_J = s.clamp_min(tiny), J.clamp_min(tiny)
    ratio = (q / (safe_J * safe_s)).clamp_min(1.0)
    observed = (J > 0) & (s > tiny)
    peak = torch.where(observed, J * (ratio - 1 - ratio.log()), 0.0)
    return peak, torch.where(observed, (ratio - 1) / safe_s, 0.0)
