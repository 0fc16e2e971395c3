"""Filters of one object that shows itself slowly, in float64: a dense chain, and particles.

Both take the noise as known, and powers as the intensity has them: in each step each tone has one of some
powers around a level that persists.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

F64 = torch.float64


class Levels(NamedTuple):
    """Powers of the tones.

    Attributes:
        power: `(G,)`.
        share: `(L, 1 + G)` of no power, and of each power, at every level.
        transition: `(L, L)`.
    """

    power: Tensor
    share: Tensor
    transition: Tensor


def log_ratios(response: Tensor, snapshots: Tensor, noise: float, levels: Levels) -> Tensor:
    """Log-likelihood ratio of an object to noise alone at every level, `(X, L)`.

    Args:
        response: `(X, I, M)`.
        snapshots: `(I, J, M)`.
        noise: variance.
        levels: powers of the tones.
    """
    total = torch.zeros(len(response), len(levels.share), dtype=F64)
    energy = response.abs().square().sum(-1)
    for tone in range(response.shape[1]):
        output = (response[:, tone].conj() @ snapshots[tone].mT).abs().square().sum(-1)
        terms = [torch.zeros_like(output)]
        for gamma in levels.power:
            gain = 1 + gamma * energy[:, tone] / noise
            terms.append(gamma * output / noise**2 / gain - snapshots.shape[1] * gain.log())
        total += (torch.stack(terms, -1).exp() @ levels.share.mT).log()
    return total


def run_chain(transition: Tensor, birth: Tensor, survival: float, ratio: Tensor) -> tuple[Tensor, Tensor]:
    """Odds of each state after every step, `(K, X)`, and evidence of every step over that of noise, `(K,)`.

    Args:
        transition: `(X, X)` from one state to another; what rows lack is lost.
        birth: `(X,)` odds of a new object.
        survival: p_s.
        ratio: `(K, X)` likelihood ratios.
    """
    odds, found, evidence = torch.zeros_like(birth), [], []
    for likelihood in ratio:
        predicted = survival * (odds @ transition) + birth
        odds = predicted * likelihood
        evidence.append(((1 + odds.sum()) / (1 + predicted.sum())).log())
        found.append(odds)
    return torch.stack(found), torch.stack(evidence)


def run_particles(
    respond: Callable[[Tensor], Tensor],
    snapshots: Tensor,
    noise: float,
    levels: Levels,
    box: tuple[float, float],
    rates: tuple[float, float],
    driving: float,
    births: Tensor,
    survivals: Tensor,
    rng: torch.Generator,
    particles: int = 20_000,
) -> Tensor:
    """Evidence of every step over that of noise alone, `(K, W)`, of W settings on the same particles.

    A Bernoulli filter (Ristic et al., "A tutorial on Bernoulli filters", IEEE Trans. SP 61, 2013) in one
    coordinate: an object is born where there is none, uniform in the box and in its rates, moves with
    constant velocity, and ends with `1 - p_s` or where it leaves the box. The time step is one.

    Args:
        respond: positions `(X, 1)` to responses `(X, I, M)`.
        snapshots: `(K, I, J, M)`.
        noise: variance.
        levels: powers of the tones.
        box: limits of the position.
        rates: limits of new rates.
        driving: variance of the driving noise.
        births: `(W,)` probability of a new object.
        survivals: `(W,)`.
        rng: random numbers.
        particles: of which as many are drawn anew from births in each step as are kept.
    """

    def uniform(limits: tuple[float, float]) -> Tensor:
        return limits[0] + (limits[1] - limits[0]) * torch.rand(particles, dtype=F64, generator=rng)

    state = torch.zeros(2, 0, dtype=F64)
    level, weight = torch.zeros(0, dtype=torch.int64), torch.zeros(0, len(births), dtype=F64)
    evidence, number = [], len(levels.share)
    for data in snapshots:
        push = math.sqrt(driving) * torch.randn(state.shape[1], dtype=F64, generator=rng)
        state = torch.stack([state[0] + state[1] + push / 2, state[1] + push])
        if len(level):
            level = torch.multinomial(levels.transition[level], 1, generator=rng)[:, 0]
        inside = (state[0] >= box[0]) & (state[0] <= box[1])
        absent = 1 - weight.sum(0)
        weight = survivals * weight * inside[:, None]
        state = torch.cat([state, torch.stack([uniform(box), uniform(rates)])], 1)
        level = torch.cat([level, torch.randint(number, (particles,), generator=rng)])
        weight = torch.cat([weight, (births * absent).expand(particles, -1) / particles])
        absent = 1 - weight.sum(0)
        ratio = log_ratios(respond(state[0][:, None]), data, noise, levels).exp()
        weight = weight * ratio.gather(1, level[:, None])
        total = absent + weight.sum(0)
        evidence.append(total.log())
        weight = weight / total
        # As many as before, in proportion to the mean of all settings: the weights of each make up for it.
        mean = weight.mean(1)
        along = (torch.arange(particles) + torch.rand(1, dtype=F64, generator=rng)) / particles
        end = mean.cumsum(0)
        index = torch.searchsorted(end, along * end[-1]).clamp_max(len(mean) - 1)
        weight = weight[index] / mean[index, None] * end[-1] / particles
        state, level = state[:, index], level[index]
    return torch.stack(evidence)
