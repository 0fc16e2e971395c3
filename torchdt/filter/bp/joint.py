"""Marginals of objects that overlap, from joint configurations instead of messages.

BP replaces every other object by a Gaussian of its covariance. Where responses are alike and it is open what
is there, that is wrong: a weak object beside a strong one is missed, two equal ones swallow each other. Such
objects form clusters. Of a cluster, configurations `c_s` of existence, states and powers are drawn from the
beliefs, and the marginal of object n is the mixture of its exact beliefs given what each configuration says
of the others (Rao and Blackwell),

    p(x_n, gamma_n, r_n | z) = sum_s W_s p(x_n, gamma_n, r_n | z, c_s without n),
    W_s ~ p(z | c_s without n) p(c_s without n) / q(c_s without n).

Objects outside the cluster, and the noise, are as they are believed to be. Labellings that exchange two
objects are among the proposals, and so are averaged over.
"""

import math

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid, softplus

from torchdt.core.trees import select, tree_map
from torchdt.core.weights import log_sum, normalise
from torchdt.filter.bp.beliefs import Beliefs, as_belief, store
from torchdt.filter.bp.configurations import (
    Configurations,
    UniformDraws,
    doubtful,
    draw_configurations,
    labellings,
    log_mixture,
    log_probability_of_each,
)
from torchdt.filter.bp.messages import ObjectBelief, object_belief
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.bp.rank_one import whiten
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.noise.base import NoiseCovariance

DOUBT, PRIOR = 0.3, 0.2
"""Least probability with which existence and absence are drawn, and share of the prior in states and powers:
where BP is wrong it is sure of it."""

CERTAIN = 1e-3
"""Existence this close to nothing or one is decided."""

LARGEST = 2**24
"""Entries of the largest temporary, about."""


@torch.no_grad()
def clusters(beliefs: Beliefs, coherence: float, exchange: Tensor) -> Tensor:
    """Other objects in the cluster of each, `(*batch, N, N)` bool.

    Two objects overlap where their responses are coherent, and one of them may be there or not, or both could
    change places. Clusters are what hangs together.

    Args:
        beliefs: that the messages leave.
        coherence: share of the energy of a response that another explains, in the mean over tones and over
            what is believed of both, from which on they overlap.
        exchange: `(*batch, N, N)` bool, pairs that could change places; the upper triangle is read.
    """
    moment, r = beliefs.moment, torch.sigmoid(beliefs.objects.log_odds)
    flat = moment.movedim(-3, -4).flatten(-2)  # (*batch, I, N, M M)
    energy = moment.diagonal(dim1=-2, dim2=-1).real.sum(-1).mT  # (*batch, I, N)
    scale = (energy[..., :, None] * energy[..., None, :]).clamp_min(torch.finfo(energy.dtype).tiny)
    alike = ((flat @ flat.mH).real / scale).mean(-3) >= coherence
    undecided = (r > CERTAIN) & (r < 1 - CERTAIN)
    either = undecided[..., :, None] | undecided[..., None, :] | exchange | exchange.mT
    there = r > CERTAIN
    itself = torch.eye(r.shape[-1], dtype=torch.bool, device=r.device)
    reach = (alike & either & there[..., :, None] & there[..., None, :]) | itself
    for _ in range(r.shape[-1].bit_length()):
        reach = (reach.to(r.dtype) @ reach.to(r.dtype)) > 0
    return reach & ~itself


def joint_marginals(
    prior: Objects,
    response: Tensor,
    measurement: Measurement,
    beliefs: Beliefs,
    cluster: Tensor,
    exchange: Tensor,
    uniform: UniformDraws,
    noise_model: NoiseCovariance,
) -> Beliefs:
    """Beliefs in which those of clustered objects come from joint configurations.

    Gradients flow through likelihood and prior; the proposal is a constant.

    Args:
        prior: predicted objects, batch `(*batch, N)`.
        response: `(*batch, N, I, P, M)` complex responses of their particles.
        measurement: statistics of the step, batch `(*batch,)`.
        beliefs: that the messages leave.
        cluster: see `clusters`.
        exchange: `(*batch, N, N)` bool, pairs that could change places.
        uniform: draws for S configurations.
        noise_model: what the noise makes of the covariance of the data.

    Raises:
        NumericalError: where a covariance is not positive definite or a message not finite.
    """
    before = as_belief(prior)
    found, active = labellings(prior, response, measurement, beliefs, exchange & cluster, noise_model)
    proposals = [doubtful(_mixed(c, before), DOUBT) for c in found]
    drawn = draw_configurations(proposals, active, beliefs.noise, uniform, DOUBT)
    with torch.no_grad():
        each = [log_probability_of_each(q, drawn.exists, drawn.state, drawn.power) for q in proposals]
        log_q = torch.stack(each, -1)
    log_p = log_probability_of_each(before, drawn.exists, drawn.state, drawn.power)
    result, dim, per_sample = beliefs, prior.log_odds.ndim - 1, measurement.unsqueeze()
    exact = per_sample._replace(factor=per_sample.factor.to(torch.complex128))
    for n in range(prior.log_odds.shape[-1]):
        others = cluster[..., n, :]
        if not bool(others.any()):
            continue
        signal = _signal(prior, response, beliefs, others, drawn, n)
        covariance = noise_model.covariance(signal, beliefs.noise.mean.unsqueeze(-2), per_sample.present)
        one = tree_map(lambda t: t.select(dim, n).unsqueeze(dim), (before, prior.power, response))  # noqa: B023
        given = _given(per_sample, covariance, *one, dim)
        log_ratio = softplus(given.log_odds) - softplus(one[0].log_odds)
        left = others[..., None]
        log_density = torch.where(left[..., None], log_q, 0.0).sum(-3)
        log_weight = (
            gaussian_log_likelihood(exact, covariance).sum(-1)
            + log_ratio
            + torch.where(left, log_p, 0.0).sum(-2)
            - log_mixture(log_density, active)
        )
        marginal = _mixture(given, normalise(log_weight)[0].to(log_ratio))
        index = torch.full_like(prior.label[..., 0], n)
        stored = store(result, index, marginal, prior, response.select(dim, n))
        result = select(others.any(-1), stored, result)
    return result


def _mixed(belief: ObjectBelief, prior: ObjectBelief) -> ObjectBelief:
    """A belief whose states and powers have a share of the prior."""

    def with_prior(after: Tensor, before: Tensor) -> Tensor:
        return torch.logaddexp(after + math.log1p(-PRIOR), normalise(before)[0] + math.log(PRIOR)).detach()

    states, powers = (with_prior(a, b) for a, b in zip(belief[:2], prior[:2], strict=True))
    return ObjectBelief(states, powers, belief.log_odds.detach())


def _signal(
    prior: Objects, response: Tensor, beliefs: Beliefs, others: Tensor, drawn: Configurations, n: int
) -> Tensor:
    """Covariance of what object n is tested against but for the noise, `(*batch, S, I, M, M)` complex128.

    Of its cluster, `others` `(*batch, N)`, what each configuration says; of the rest what is believed.
    """
    there = (drawn.exists & others[..., None]).unsqueeze(-2)
    drawn_power = torch.where(there, prior.power.gather(-1, drawn.power), 0.0)
    particle = drawn.state[..., None, :, None].expand(*drawn_power.shape, response.shape[-1])
    # The root has an infinite derivative at zero, of which where() makes no nothing but nan.
    sounds = drawn_power > 0
    amplitude = torch.where(sounds, torch.where(sounds, drawn_power, 1.0).sqrt(), 0.0)
    columns = response.gather(-2, particle).to(torch.complex128) * amplitude[..., None]
    columns = columns.movedim((-4, -2), (-1, -4))  # (*batch, S, I, M, N)
    itself = torch.zeros_like(others)
    itself[..., n] = True
    strength = torch.where((others | itself)[..., None], 0.0, beliefs.strength)
    rest = signal_covariance(strength, beliefs.moment)
    if beliefs.diffuse is None:
        return columns @ columns.mH + rest.unsqueeze(-4)
    # Its own diffuse part is there at its power: what no response explains is no evidence for one.
    transmits = prior.transmits.gather(-1, drawn.state).unsqueeze(-2)
    sent = drawn_power * transmits
    weights = sent.movedim(-3, -1).to(columns.dtype)  # (*batch, I, S, N)
    flat = beliefs.diffuse.movedim(-4, -3).flatten(-2).to(columns.dtype)  # (*batch, I, N, M M)
    spread = (weights @ flat).unflatten(-1, rest.shape[-2:]).movedim(-4, -3)
    own = signal_covariance(torch.where(itself[..., None], beliefs.power, 0.0), beliefs.diffuse)
    return columns @ columns.mH + spread + (rest + own).unsqueeze(-4)


def _given(
    measurement: Measurement,
    covariance: Tensor,
    prior: ObjectBelief,
    power: Tensor,
    response: Tensor,
    dim: int,
) -> ObjectBelief:
    """Beliefs `(*batch, S)` of one object against each covariance, a few at a time."""
    width = 2 * (covariance.shape[-1] + measurement.factor.shape[-1])
    size = max(1, LARGEST // (response[..., 0].numel() * max(width, power.shape[-1])))
    parts = [
        object_belief(whiten(measurement, part)._replace(), response, power, prior)
        for part in covariance.to(response.dtype).split(size, dim)
    ]
    return ObjectBelief(*(torch.cat(t, dim) for t in zip(*parts, strict=True)))


def _mixture(given: ObjectBelief, log_weight: Tensor) -> ObjectBelief:
    """The mixture of S beliefs, `(*batch, S)` to `(*batch,)`."""
    log_there, log_not = log_weight + logsigmoid(given.log_odds), log_weight + logsigmoid(-given.log_odds)
    log_share, log_r = normalise(log_there)
    return ObjectBelief(
        log_sum(given.log_weight + log_share[..., None], -2),
        log_sum(given.log_power_weight + log_share[..., None, None], -3),
        log_r - log_sum(log_not, -1),
    )
