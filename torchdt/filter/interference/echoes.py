"""Leftovers and echoes: what looks like a weak object and sends what stronger ones send.

A response that is not quite right, or a second way to the array, leaves energy that a false object explains
well. But its amplitudes are those of its parents, `sum_p alpha_p s_pj` in every snapshot j, where an object
of its own has others. With the parents' amplitudes at their conditional mean, `s_pj = gamma_p a_p^H Sigma^-1
z_j`, and `alpha_p ~ CN(0, tau^2)` in each tone, echoes are worth, beside nothing,

    `y S^H (I / tau^2 + g S S^H)^-1 S y^H - log|I + tau^2 g S S^H|`,

    y_j = a^H Sigma^-1 z_j,    g = a^H Sigma^-1 a,    S = (s_pj)

nats, which is exact given the amplitudes. As many parents as snapshots explain anything: one fewer is asked.

What a response itself leaves has the amplitudes of its object too: a signature `a + v` with `v ~ CN(0, tau^2
|a|^2 / M I)`. With `b = sum_j (z_j - a s_j) s_j^* / |s|` and `t = tau^2 |a|^2 |s|^2 / M` it is worth

    `b^H Sigma^-1 b - b^H (Sigma + t I)^-1 b - log|I + t Sigma^-1|`,

in the mean over tau^2 of several sizes, since nobody knows how good a response is.
"""

import math

import torch
from torch import Tensor
from torch.nn.functional import softplus

from torchdt.core.linalg import cholesky
from torchdt.filter.bp.rank_one import Whitener
from torchdt.filter.interference.signatures import SURPRISE
from torchdt.model.measurement import Measurement

PARTS = (1.0, 0.25, 0.0625, 0.0156)
"""Of the largest share that a response is thought to leave."""


@torch.no_grad()
def echo_gain(
    whitener: Whitener, response: Tensor, parents: Tensor, power: Tensor, share: float, new: Tensor
) -> Tensor:
    """Nats that echoes of other objects are worth beside no object, price paid, `(*batch,)`, from zero up.

    Args:
        whitener: of all but the object, batch `(*batch,)`.
        response: `(*batch, I, M)` complex, of the object.
        parents: `(*batch, N, I, M)` complex, of those that it could be an echo of.
        power: `(*batch, N, I)` of the parents; zero for none.
        share: tau^2, mean energy of an echo over that of its parent.
        new: `(*batch,)` bool, whether the echo would begin; what has been there may always have been one.

    Raises:
        NumericalError: where the amplitudes are not finite.
    """
    num_sensors, num = response.shape[-1], parents.shape[-3]
    root, spread = whitener.projection.to(torch.complex128).tensor_split([num_sensors], -1)
    own = response.to(root.dtype)[..., None]
    g = (root.mH @ own).abs().square().sum((-2, -1))[..., None, None]  # (*batch, I, 1, 1)
    received = spread.mH @ own  # (*batch, I, R, 1), conjugate of a^H Sigma^-1 B
    amplitude = power.mT[..., None] * (parents.movedim(-3, -2).conj().to(root.dtype) @ spread)
    eye = torch.eye(num, dtype=root.dtype, device=root.device)
    lower = cholesky(eye + share * g * (amplitude @ amplitude.mH), "amplitudes of echoes")
    along = torch.linalg.solve_triangular(lower, amplitude @ received, upper=False)
    log_det = 2 * lower.diagonal(dim1=-2, dim2=-1).real.log().sum(-1)
    gain = share * along.abs().square().sum((-2, -1)) - log_det
    # Nothing at all may be there too: as likely as echoes where there may always have been some.
    surprise = SURPRISE * new.to(gain.dtype)
    total = torch.where((power > 0).any(-1).any(-1), gain.sum(-1), -torch.inf)
    mixed = torch.logaddexp(total - surprise, torch.zeros_like(total)) - softplus(-surprise)
    return mixed.clamp_min(0).to(power.dtype)


@torch.no_grad()
def leftover_gain(
    measurement: Measurement, covariance: Tensor, response: Tensor, power: Tensor, share: float
) -> Tensor:
    """Nats that what a response leaves is worth beside its object, `(*batch,)`, from zero up in each tone.

    Args:
        measurement: statistics of the step.
        covariance: Sigma, `(*batch, I, M, M)` complex, of all but the object.
        response: `(*batch, I, M)` complex, of the object.
        power: `(*batch, I)` of the object.
        share: largest tau^2, mean energy of what is left over that of the object.

    Raises:
        NumericalError: where a covariance is not positive definite.
    """
    sigma = covariance.to(torch.complex128)
    lower = cholesky(sigma, "background covariance")
    own = (response * measurement.present).to(sigma.dtype)[..., None]
    factor = measurement.factor.to(sigma.dtype)
    solved = torch.cholesky_solve(own, lower)
    gain = (own.mH @ solved).real
    amplitude = power[..., None, None] * (solved.mH @ factor) / (1 + power[..., None, None] * gain)
    norm = amplitude.abs().square().sum(-1, keepdim=True)
    b = (factor - own @ amplitude) @ amplitude.mH / norm.sqrt().clamp_min(1e-30)
    most = share * own.abs().square().sum((-2, -1), keepdim=True) * norm / own.shape[-2]
    eye = torch.eye(own.shape[-2], dtype=sigma.dtype, device=sigma.device)

    def log_density(root: Tensor) -> Tensor:
        misfit = torch.linalg.solve_triangular(root, b, upper=False).abs().square().sum((-2, -1))
        return -misfit - 2 * root.diagonal(dim1=-2, dim2=-1).real.log().sum(-1)

    wider = [cholesky(sigma + most * part * eye, "background covariance") for part in PARTS]
    mean = torch.stack([log_density(root) for root in wider]).logsumexp(0) - math.log(len(PARTS))
    return (mean - log_density(lower)).clamp_min(0).sum(-1).to(power.dtype)


def principal(moment: Tensor) -> Tensor:
    """The response a of a moment `(*batch, M, M)` close to `a a^H`, but for its phase, `(*batch, M)`."""
    diagonal = moment.diagonal(dim1=-2, dim2=-1).real
    # Each column is a but for a factor; the largest is least disturbed.
    largest = diagonal.argmax(-1)[..., None, None]
    column = moment.gather(-1, largest.expand(*moment.shape[:-1], 1)).squeeze(-1)
    norm = column.abs().square().sum(-1, keepdim=True).sqrt().clamp_min(1e-30)
    return column / norm * diagonal.sum(-1, keepdim=True).clamp_min(0).sqrt()
