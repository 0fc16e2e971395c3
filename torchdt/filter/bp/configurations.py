"""Joint configurations of all objects and the noise, drawn from beliefs.

A configuration says for every object whether it exists, its state and its powers, and the noise variance of
every tone. The proposal is the product of the posterior beliefs. Where objects overlap BP settles for one
labelling of several; then the labellings that exchange two objects are proposed too, and the density of a
configuration is that of the mixture.
"""

import itertools
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.core.random import RandomStreams
from torchdt.core.resampling import invert_cumulative
from torchdt.core.trees import put, take, tree_map
from torchdt.filter.bp.beliefs import Beliefs, as_belief, background
from torchdt.filter.bp.messages import ObjectBelief, object_belief
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseCovariance
from torchdt.model.noise.white import WHITE

DOUBT = 0.01
"""Neither existence nor absence is drawn with a smaller probability: BP may be too sure of one of them,
and a weight is then at most a hundred times what it would be. Another value: docs/quality.md."""


class UniformDraws(NamedTuple):
    """Stratified uniform draws for S configurations of N objects; a row meets each of S strata once.

    Attributes:
        existence, state: `(*batch, N, S)`.
        power: `(*batch, N, I, S)`.
        noise: `(*batch, I, S)`.
    """

    existence: Tensor
    state: Tensor
    power: Tensor
    noise: Tensor

    @classmethod
    def draw(cls, streams: RandomStreams, num_objects: int, num_tones: int, size: int) -> "UniformDraws":
        """Latin hypercube of S points."""
        rows = num_objects * (2 + num_tones) + num_tones
        order, within = streams.uniform(rows, size), streams.uniform(rows, size)
        uniform = (order.argsort(-1).to(within) + within) / size
        parts = uniform.split([num_objects, num_objects, num_objects * num_tones, num_tones], -2)
        return cls(parts[0], parts[1], parts[2].unflatten(-2, (num_objects, num_tones)), parts[3])

    def pick(self, known: int, slots: int, newborn: int) -> "UniformDraws":
        """Draws of the first known objects, and of the first new ones behind all slots."""

        def choose(draws: Tensor, dim: int) -> Tensor:
            return torch.cat([draws.narrow(dim, 0, known), draws.narrow(dim, slots, newborn)], dim)

        return UniformDraws(
            choose(self.existence, self.existence.ndim - 2),
            choose(self.state, self.state.ndim - 2),
            choose(self.power, self.power.ndim - 3),
            self.noise,
        )


class Configurations(NamedTuple):
    """S joint configurations, as indices of support points.

    Attributes:
        exists: `(*batch, N, S)` bool.
        state: `(*batch, N, S)` int64.
        power: `(*batch, N, I, S)` int64.
        noise: `(*batch, I, S)` int64.
        log_proposal: `(*batch, S)` log-probability with which each was drawn; state and powers of objects
            that do not exist are not part of it.
    """

    exists: Tensor
    state: Tensor
    power: Tensor
    noise: Tensor
    log_proposal: Tensor


def log_probability(objects: ObjectBelief, exists: Tensor, state: Tensor, power: Tensor) -> Tensor:
    """Log-probability of configurations of the objects under independent beliefs, `(*batch, S)`."""
    return log_probability_of_each(objects, exists, state, power).sum(-2)


def log_probability_of_each(objects: ObjectBelief, exists: Tensor, state: Tensor, power: Tensor) -> Tensor:
    """Log-probability of what configurations say of each object, `(*batch, N, S)`.

    Args:
        objects: beliefs of batch `(*batch, N)`.
        exists, state, power: as in `Configurations`.
    """
    log_r, log_not = logsigmoid(objects.log_odds)[..., None], logsigmoid(-objects.log_odds)[..., None]
    inside = objects.log_weight.gather(-1, state) + objects.log_power_weight.gather(-1, power).sum(-2)
    return torch.where(exists, log_r + inside, log_not)


@torch.no_grad()
def draw_configurations(
    labellings: Sequence[ObjectBelief],
    active: Tensor,
    noise: Noise,
    draws: UniformDraws,
    doubt: float = DOUBT,
) -> Configurations:
    """Draw from a mixture of beliefs, a fixed number of configurations from each.

    Args:
        labellings: C beliefs of batch `(*batch, N)` on the same support points; objects that cannot exist
            have log-odds of minus infinity.
        active: `(*batch, C)` bool, the components in use; the first always is.
        noise: belief of the noise.
        draws: uniform draws for S configurations.
        doubt: see `DOUBT`.
    """
    component = _component(active, draws.noise.shape[-1])
    exists, state, power = (torch.zeros_like(d, dtype=torch.int64) for d in draws[:3])
    proposals = []
    for c, labelling in enumerate(labellings):
        hedged = doubtful(labelling, doubt)
        chosen = (component == c).unsqueeze(-2)
        there = (draws.existence < torch.sigmoid(hedged.log_odds)[..., None]).long()
        exists = torch.where(chosen, there, exists)
        state = torch.where(chosen, invert_cumulative(labelling.log_weight, draws.state), state)
        index = invert_cumulative(labelling.log_power_weight, draws.power)
        power = torch.where(chosen.unsqueeze(-2), index, power)
        proposals.append(hedged)
    level = invert_cumulative(noise.log_weight, draws.noise)
    density = torch.stack([log_probability(p, exists.bool(), state, power) for p in proposals], -1)
    log_proposal = log_mixture(density, active)
    log_proposal = log_proposal + noise.log_weight.gather(-1, level).sum(-2)
    return Configurations(exists.bool(), state, power, level, log_proposal)


def _component(active: Tensor, size: int) -> Tensor:
    """The labelling that each of S configurations is drawn from, `(*batch, S)`: `(*batch, C)` in turn."""
    rank = torch.arange(size, device=active.device) * active.sum(-1, keepdim=True) // size
    return torch.sort(active, dim=-1, descending=True, stable=True).indices.gather(-1, rank)


def log_mixture(log_density: Tensor, active: Tensor) -> Tensor:
    """Log-density of the mixture that S configurations are drawn from, `(*batch, S)`.

    Args:
        log_density: `(*batch, S, C)` of each labelling.
        active: `(*batch, C)` bool, those in use.
    """
    size, num = log_density.shape[-2:]
    drawn = _component(active, size)[..., None] == torch.arange(num, device=active.device)
    share = drawn.sum(-2, keepdim=True).to(log_density) / size
    return torch.logsumexp(log_density + share.log(), -1)


def doubtful(belief: ObjectBelief, doubt: float) -> ObjectBelief:
    """A belief that is sure of neither existence nor absence, but for objects that cannot exist."""
    r = torch.sigmoid(belief.log_odds).clamp(doubt, 1 - doubt)
    return belief._replace(log_odds=torch.where(belief.log_odds.isneginf(), -torch.inf, torch.logit(r)))


@torch.no_grad()
def labellings(
    prior: Objects,
    response: Tensor,
    measurement: Measurement,
    beliefs: Beliefs,
    exchangeable: Tensor,
    noise_model: NoiseCovariance = WHITE,
) -> tuple[list[ObjectBelief], Tensor]:
    """The beliefs, and for each exchangeable pair of objects those in which the two change places.

    An object takes another's place by being tested against everything but that other, itself as it was
    included.

    Args:
        prior: predicted objects, batch `(*batch, N)`.
        response: `(*batch, N, I, P, M)` complex.
        measurement: statistics of the step.
        beliefs: posterior beliefs.
        exchangeable: `(*batch, N, N)` bool, of which the upper triangle is read.
        noise_model: what the noise makes of the covariance of the data.

    Returns:
        Components and which of them are in use, for `draw_configurations`.
    """
    components = [beliefs.objects]
    active = [torch.ones_like(exchangeable[..., 0, 0])]
    for n, m in itertools.combinations(range(exchangeable.shape[-1]), 2):
        if not bool(exchangeable[..., n, m].any()):
            continue
        exchanged = beliefs.objects
        for slot, place in ((n, m), (m, n)):
            at = torch.full_like(prior.label[..., 0], slot)
            others = background(beliefs, measurement, torch.full_like(at, place), noise_model=noise_model)
            whitener = whiten(measurement, others)
            one = tree_map(partial(take, index=at), as_belief(prior))
            belief = object_belief(whitener, take(response, at), take(prior.power, at), one)
            exchanged = ObjectBelief(*(put(t, at, v) for t, v in zip(exchanged, belief, strict=True)))
        components.append(exchanged)
        active.append(exchangeable[..., n, m])
    return components, torch.stack(active, -1)
