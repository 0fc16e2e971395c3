"""What a set of points says about the data: least squares in the amplitudes, and a ratio test of each point.

With the responses of the other points projected out of data and response, `R = P B`, one point explains the
share `|(P a)^H R|^2 / (|P a|^2 tr R R^H)` of what is left. No noise level need be known for a test of it.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.baselines.detect.climb import climb
from torchdt.baselines.detect.peaks import close
from torchdt.baselines.detect.points import Points
from torchdt.core.linalg import cholesky
from torchdt.core.trees import put, take
from torchdt.field.base import Field
from torchdt.filter.bp.rank_one import Whitener, statistics
from torchdt.filter.proposal.moved import respond
from torchdt.model.measurement import Measurement
from torchdt.model.region import Region

RIDGE = 1e-12
"""Added to the squared norm of unit responses, for points of equal responses."""

NEGLIGIBLE = 1e-20
"""Share of a tone's energy up to which what is left is rounding, not data."""

CYCLES = 2
"""Times that every point is moved; one is too few for two close ones, a third moves them no more."""


class Remainder(NamedTuple):
    """What is left for one more point when those of a set are projected out.

    Attributes:
        complement: `(*batch, I, M, M)` complex P.
        residual: `(*batch, I, M, R)` complex `R / sqrt(tr R R^H)`; zero for a tone without data, or one that
            is explained in full.
        num_snapshots: `(*batch, I)` real J.
        free: `(*batch, I)` real, number of sensors less number of points in the set.
    """

    complement: Tensor
    residual: Tensor
    num_snapshots: Tensor
    free: Tensor


class _Fit(NamedTuple):
    """Least squares of the data in unit-norm responses, double precision.

    Attributes:
        unit: `(*batch, I, Q, M)` responses of unit norm over the sensors that are present; zero where absent.
        norm: `(*batch, I, Q)` what they were divided by.
        inverse: `(*batch, I, Q, Q)` of their Gram matrix.
        amplitude: `(*batch, I, Q, R)` coefficients of the factor's columns.
        residual: `(*batch, I, M, R)` factor without what the points explain.
    """

    unit: Tensor
    norm: Tensor
    inverse: Tensor
    amplitude: Tensor
    residual: Tensor


def _explain(response: Tensor, present: Tensor, measurement: Measurement) -> _Fit:
    # Sources 30-40 dB above the noise would leave few digits of what is left in single precision.
    kept = (measurement.present[..., None, :] > 0) & present[..., None, :, None]
    response = torch.where(kept, response.transpose(-3, -2).to(torch.complex128), 0.0)
    factor = measurement.factor.to(response.dtype)
    norm = torch.linalg.vector_norm(response, dim=-1)
    unit = response / norm.clamp_min(torch.finfo(norm.dtype).tiny)[..., None]
    diagonal = torch.where(norm > 0, RIDGE, 1.0).to(unit.dtype)
    lower = cholesky(unit.conj() @ unit.mT + torch.diag_embed(diagonal), "Gram matrix of the points")
    inverse = torch.cholesky_inverse(lower)
    amplitude = inverse @ (unit.conj() @ factor)
    return _Fit(unit, norm, inverse, amplitude, factor - unit.mT @ amplitude)


def _energy(factor: Tensor) -> Tensor:
    return factor.abs().square().sum((-2, -1))


def _share(part: Tensor, left: Tensor, measurement: Measurement) -> Tensor:
    """`part / left` of energies `(*batch, I, N)`; 0 where what is left is but rounding."""
    energy = _energy(measurement.factor.to(torch.complex128))[..., None]
    something = left > NEGLIGIBLE * energy
    return torch.where(something, part / torch.where(something, left, 1.0), 0.0)


def log_ratio(J: Tensor, free: Tensor, share: Tensor) -> Tensor:
    """Likelihood ratio of a point in noise of unknown variance, at the best power and noise variances.

    With the point, J snapshots in n dimensions have one variance `x = n share` and n - 1 of
    `(n - x) / (n - 1)`, relative to their mean, so the ratio is
    `J [-log x - (n - 1) log((n - x) / (n - 1))]`. For large n that is `J (x - 1 - log x)`, the
    `peak_log_likelihood_ratio` in noise of known variance.

    Args:
        J: number of snapshots.
        free: n, number of sensors less number of other points.
        share: of the energy that the point explains, from 0 to 1. All broadcast against each other.

    Returns:
        Nats, >= 0; 0 where a point explains no more than any other direction would (`x <= 1`).
    """
    eps = torch.finfo(share.dtype).eps
    x, rest = free * share, (free - 1).clamp_min(1.0)
    least = ((free - x) / rest).clamp_min(eps)
    return torch.where((x > 1) & (free > 1), J * (-x.clamp_min(1.0).log() - rest * least.log()), 0.0)


def project_out(response: Tensor, present: Tensor, measurement: Measurement) -> Remainder:
    """Project a set of points out of the data.

    Args:
        response: `(*batch, Q, I, M)` complex.
        present: `(*batch, Q)` bool, which of them are in the set.
        measurement: statistics, batch `(*batch,)`.

    Raises:
        NumericalError: where a response is not finite.
    """
    fit = _explain(response, present, measurement)
    eye = torch.diag_embed(measurement.present).to(fit.unit.dtype)
    complement = eye - fit.unit.mT @ fit.inverse @ fit.unit.conj()
    left = _energy(fit.residual)[..., None]
    scale = _share(torch.ones_like(left), left, measurement).sqrt()
    free = measurement.present.sum(-1) - present.sum(-1, keepdim=True)
    dtype = measurement.factor.dtype
    residual = (fit.residual * scale[..., None]).to(dtype)
    return Remainder(complement.to(dtype), residual, measurement.num_snapshots, free)


def ratio(remainder: Remainder, response: Tensor) -> Tensor:
    """`log_ratio` of one more point, the sum of all tones.

    Args:
        remainder: batch `(*batch,)`.
        response: `(*batch, I, S, M)` complex.

    Returns:
        `(*batch, S)` nats, >= 0.
    """
    J, free = remainder.num_snapshots, remainder.free
    projection = torch.cat([remainder.complement, remainder.residual], -1)
    s, q = statistics(Whitener(projection, J), response)
    return log_ratio(J[..., None], free[..., None], q / s.clamp_min(torch.finfo(s.dtype).tiny)).sum(-2)


def describe(response: Tensor, position: Tensor, present: Tensor, measurement: Measurement) -> Points:
    """Powers, noise and strengths of a set of points.

    Amplitudes are least squares in all points together, `A^+ B`. The power of a point is their mean square
    over the snapshots, the noise variance is `tr[(I - A A^+) S] / (J (M - Q))`, and the strength is the
    `log_ratio` of the point given the other ones, summed over the tones.

    Args:
        response: `(*batch, Q, I, M)` complex.
        position: `(*batch, Q, d)`.
        present: `(*batch, Q)` bool.
        measurement: statistics, batch `(*batch,)`.

    Returns:
        The same points, strongest first. Points of equal responses share their amplitude and have no
        strength. With as many points as sensors the noise variance is but rounding.

    Raises:
        NumericalError: where a response is not finite.
    """
    fit = _explain(response, present, measurement)
    J = measurement.num_snapshots.to(fit.norm.dtype)
    free = measurement.present.sum(-1).to(J.dtype) - present.sum(-1, keepdim=True)
    square, left = fit.amplitude.abs().square().sum(-1), _energy(fit.residual)
    # One factorisation serves all: 1 / (G^-1)_nn is |P a_n|^2, and a_n^H R_n / |P a_n|^2 the amplitude.
    explained = square / fit.inverse.diagonal(dim1=-2, dim2=-1).real
    share = _share(explained, left[..., None] + explained, measurement)
    strength = log_ratio(J[..., None], free[..., None] + 1, share).sum(-2)
    tiny = torch.finfo(J.dtype).tiny
    power = (square / (J[..., None] * fit.norm.square()).clamp_min(tiny)).mT
    noise = left / (J * free.clamp_min(1.0)).clamp_min(tiny)
    dtype = measurement.num_snapshots.dtype
    points = Points(position, strength, power, present, noise).strongest_first()
    return points._replace(
        strength=points.strength.to(dtype), power=points.power.to(dtype), noise=noise.to(dtype)
    )


def polish(
    field: Field,
    region: Region,
    position: Tensor,
    present: Tensor,
    measurement: Measurement,
    separation: float = 0.0,
) -> Tensor:
    """Move each point in turn to the peak of its ratio test given the others.

    The cyclic refinement of Mamandipoor, Ramasamy and Madhow (IEEE Trans. Signal Process. 64, 2016).

    Args:
        position: `(*batch, Q, d)` inside the region, strongest first.
        present: `(*batch, Q)` bool.
        measurement: statistics, batch `(*batch,)`.
        separation: in cells; no point moves closer than this to another one in every coordinate.

    Returns:
        `(*batch, Q, d)`; absent points stay.
    """
    for point in [*range(position.shape[-2])] * CYCLES:
        index = torch.full_like(present[..., 0], point, dtype=torch.int64)
        moves, start = take(present, index), take(position, index)
        if not bool(moves.any()):
            continue
        others = put(present, index, torch.zeros_like(moves))
        remainder = project_out(field(position), others, measurement)

        def score(x: Tensor) -> Tensor:
            difference = region.difference(x[..., :, None, :], position[..., None, :, :]) / region.cell  # noqa: B023
            taken = (close(difference, separation) & others[..., None, :]).any(-1)  # noqa: B023
            return ratio(remainder, respond(field, x)).masked_fill(taken, -torch.inf)  # noqa: B023

        best = climb(score, start, region)
        position = put(position, index, torch.where(moves[..., None], best, start))
    return position
