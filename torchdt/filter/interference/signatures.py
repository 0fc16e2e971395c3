"""Signals of free spatial signature: fitted to what objects and noise leave, at the price of their numbers.

Beside `Sigma`, a signal of any spatial vector c is worth, of J snapshots with scatter matrix S,

    J (lambda / J - 1 - log(lambda / J)),    lambda the largest eigenvalue of Sigma^-1 S,

nats at its best, where `c c^H` has power `lambda / J - 1` behind the whitened array. Noise alone is worth
something too, since the vector is free, and so is a point in the space of vectors: with M sensors and a prior
as wide as the energy received, Laplace's approximation of `log integral p(z | c) p(c) dc` takes off

    (M - 1) log(1 + J E / (M eta))

nats. Both are the price. It does not depend on what is explained otherwise, or a wrong explanation of half of
a signal would make the rest cheap.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.linalg import cholesky
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.noise.base import Noise, NoiseCovariance

SURPRISE = math.log(100.0)
"""Nats against a new signal in a tone, and what one that goes on costs: one in a hundred steps begins."""


DRIFT = 0.01
"""Share of the energy of a signature that leaves it within a step."""


LEVELS = 8
"""Noise levels at which interferers are looked for."""


class Interferers(NamedTuple):
    """Signals of free signature, K a tone at most.

    Attributes:
        columns: `(*batch, I, M, K)` complex, signature times the root of the power; zero for none.
        cost: `(*batch, I)` nats that their numbers cost.
        before: `(*batch, I, M, K)` columns of the last step, in whose directions they may cost less.
    """

    columns: Tensor
    cost: Tensor
    before: Tensor

    @property
    def covariance(self) -> Tensor:
        """`sum_k c_k c_k^H`, `(*batch, I, M, M)`."""
        return self.columns @ self.columns.mH

    @property
    def any(self) -> bool:
        """Whether there is one anywhere in the batch."""
        return bool((self.columns != 0).any())


def peak_gain(J: Tensor, level: Tensor) -> Tensor:
    """Nats that a signal along a whitened vector u is worth at its best power, `level = u^H S u`."""
    ratio = (level / J.clamp_min(torch.finfo(level.dtype).tiny)).clamp_min(1.0)
    return torch.where(J > 0, J * (ratio - 1 - ratio.log()), 0.0)


def price(measurement: Measurement, variance: Tensor) -> Tensor:
    """Nats that a signal of free signature must be worth, `(*batch, I)`.

    Args:
        measurement: statistics of the step.
        variance: eta, `(*batch, I)`.
    """
    J, M = measurement.num_snapshots, measurement.present.sum(-1)
    of_noise = (M.sqrt() + J.sqrt()).square()  # largest eigenvalue of the scatter of white noise, about
    volume = (M - 1).clamp_min(0) * torch.log1p(J * measurement.energy / (M * variance).clamp_min(1e-30))
    return peak_gain(J, of_noise) + volume + SURPRISE


def free_gains(measurement: Measurement, covariance: Tensor, number: int) -> Tensor:
    """Nats that signals of free signature are worth beside a covariance, `(*batch, I, number)`.

    Args:
        measurement: statistics, batch `(*batch,)`.
        covariance: `(*batch, I, M, M)` complex, of all else.
        number: of signals, those that are worth most; fewer where the data have a smaller rank.
    """
    white = _whitened(measurement, covariance)[1]
    J = measurement.num_snapshots
    level = torch.linalg.eigvalsh(_small_gram(white))[..., -number:]
    return peak_gain(J[..., None], level.to(J.dtype))


def follow(
    measurement: Measurement,
    noise_model: NoiseCovariance,
    noise: Noise,
    signal: Tensor,
    before: Tensor,
    memory: float,
    new: bool,
    share: float,
) -> Interferers:
    """The signals of free signature that are worth their price, at the noise level at which all is likeliest.

    What they explain is no noise, and less noise leaves more to be explained: both are sought together, over
    some of the levels that are believed possible.

    Args:
        measurement: statistics of the step.
        noise_model: what the noise makes of the covariance of the data.
        noise: belief about its level before the data.
        signal: `(*batch, I, M, M)` complex, of what objects send.
        before, memory, new: see `fit`.
        share: see `beside_leftovers`.
    """
    every = max(1, noise.variance.shape[-1] // LEVELS)
    level = noise.variance[..., every // 2 :: every].movedim(-1, -2)  # (*batch, E, I)
    log_prior = noise.log_weight[..., every // 2 :: every].movedim(-1, -2)
    each = measurement.unsqueeze()
    covariance = noise_model.covariance(signal.unsqueeze(-4), level, each.present)
    cost = price(each, level)
    apart = beside_leftovers(each, covariance, signal.unsqueeze(-4), level, share)
    at_level, gain = fit(each, covariance, before.unsqueeze(-4), cost, memory, new, apart)
    score = gaussian_log_likelihood(each, covariance) + gain + log_prior
    best = score.argmax(-2, keepdim=True)
    wide = best[..., None, None].expand(*best.shape, *before.shape[-2:])
    columns = at_level.columns.gather(-4, wide).squeeze(-4)
    return Interferers(columns, at_level.cost.gather(-2, best).squeeze(-2), before)


def beside_leftovers(
    measurement: Measurement, covariance: Tensor, signal: Tensor, variance: Tensor, share: float
) -> Tensor:
    """What turns whitened snapshots into those beside what responses leave, `(*batch, I, R, R)`.

    What responses leave has the amplitudes of their objects, and is no signal of its own. Along the
    amplitudes, the rows of the conditional mean `C Sigma^-1 B` of all that objects send, it adds a share of
    their energy to the noise of each sensor; there, snapshots say that much less.

    Args:
        measurement: statistics of the step.
        covariance: Sigma, `(*batch, I, M, M)` complex, of objects and noise.
        signal: C, `(*batch, I, M, M)` complex, of objects.
        variance: eta, `(*batch, I)`.
        share: mean energy of what a response leaves over that of its object.
    """
    lower = cholesky(covariance.to(torch.complex128), "background covariance")
    factor = measurement.factor.to(lower.dtype).expand(*lower.shape[:-1], -1)
    sent = signal.to(lower.dtype) @ torch.cholesky_solve(factor, lower)
    energy, vector = torch.linalg.eigh(sent.mH @ sent)
    of_each = (measurement.present.sum(-1) * variance).clamp_min(1e-30)[..., None]
    louder = 1 + share * energy.clamp_min(0) / of_each
    return vector @ (vector.mH / louder.sqrt()[..., None])


def fit(
    measurement: Measurement,
    covariance: Tensor,
    before: Tensor,
    cost: Tensor,
    memory: float,
    new: bool,
    apart: Tensor | None = None,
) -> tuple[Interferers, Tensor]:
    """The signals of free signature that are worth their price beside a covariance.

    Signatures are the largest eigenvectors of the whitened scatter matrix, to which those of the last step
    are added as so many steps of data as `memory` says. What goes on in an old direction costs `SURPRISE`,
    what is new the whole price.

    Args:
        measurement: statistics of the step, batch `(*batch,)`.
        covariance: `(*batch, I, M, M)` complex, of objects and noise.
        before: `(*batch, I, M, K)` columns of the last step.
        cost: see `price`.
        memory: steps of data that the last signatures count as, at most: `DRIFT` lets strong ones forget.
        new: whether new ones may begin.
        apart: see `beside_leftovers`; None where there are no objects.

    Returns:
        The signals, and what they are worth, price paid, `(*batch, I)` nats.
    """
    lower, every = _whitened(measurement, covariance)
    J, num = measurement.num_snapshots, before.shape[-1]
    white = every if apart is None else every @ apart
    # So many snapshots are left to speak for a signal; its power is that in all of them.
    left = J if apart is None else J * apart.abs().square().sum((-2, -1)).to(J.dtype) / apart.shape[-1]
    old = torch.linalg.solve_triangular(
        lower, before.to(lower.dtype).expand(*lower.shape[:-1], num), upper=False
    )
    power_before = old.abs().square().sum(-2, keepdim=True)
    remembered = old * (memory * J[..., None, None] / (1 + DRIFT * power_before)).sqrt()
    vector = torch.linalg.svd(torch.cat([every, remembered], -1), full_matrices=False).U[..., :num]
    level = (white.mH @ vector).abs().square().sum(-2)
    direction = old / power_before.sqrt().clamp_min(torch.finfo(power_before.dtype).tiny)
    overlap = (direction.mH @ vector).abs().square().sum(-2).clamp_max(1.0)
    each = SURPRISE * overlap + (1 - overlap) * cost[..., None]
    if not new:
        each = torch.where(overlap > 0.5, each, torch.inf)
    gain = peak_gain(left[..., None], level)
    kept = gain > each
    whole = (every.mH @ vector).abs().square().sum(-2)
    power = torch.where(kept, (whole / J.clamp_min(1e-30)[..., None] - 1).clamp_min(0), 0.0)
    columns = lower @ (vector * power.sqrt()[..., None, :])
    # Of a step without data nothing is known: what went on goes on.
    columns = torch.where((J > 0)[..., None, None], columns.to(before.dtype), before)
    paid, net = (torch.where(kept, t, 0.0).sum(-1).to(cost.dtype) for t in (each, gain - each))
    return Interferers(columns, paid, before), net


def _whitened(measurement: Measurement, covariance: Tensor) -> tuple[Tensor, Tensor]:
    """`L` of a covariance `L L^H`, and the whitened factor of the data, in double precision."""
    lower = cholesky(covariance.to(torch.complex128), "background covariance")
    return lower, torch.linalg.solve_triangular(lower, measurement.factor.to(lower.dtype), upper=False)


def _small_gram(factor: Tensor) -> Tensor:
    """`A A^H` or `A^H A`, whichever is smaller: their eigenvalues above zero are the same."""
    wide = factor.shape[-1] > factor.shape[-2]
    return factor @ factor.mH if wide else factor.mH @ factor
