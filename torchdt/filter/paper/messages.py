"""Messages on the factor graph of the paper (Liang and Meyer, Fig. 2), one time step.

Variables are, for every object n, its state x_n and its power state phi_n = (gamma_n, r_n), and for every
tone i the noise variance eta_i. Every snapshot j of every tone is a factor f_ij, joined to all states, all
power states and the noise of its tone. Along each edge run, in the notation of the figure,

- alpha_n, psi_n, xi_i: the predictions, from the factors of the transitions and births;
- beta_nij, zeta_nij, iota_ij: from x_n, phi_n and eta_i to f_ij, the prediction times what all other factors
  say;
- kappa_nij, lambda_nij, nu_ij: from f_ij to x_n, phi_n and eta_i.

Variables carry particles, so products are products of weights. To pass through a factor, all that it does not
send to is taken for one Gaussian of matched moments,

    `Sigma_nij = sum_{m != n} E[r_m gamma_m] E[a_m a_m^H] + E[eta_i] I`,

expectations under the messages beta, zeta and iota to that factor. With the likelihood ratio rho(x, gamma) of
an object against none in that background,

    `kappa(x) = 1 - r + r E_zeta[rho(x, gamma)]`,
    `lambda(gamma, r = 1) / lambda(r = 0) = E_beta[rho(x, gamma)]`,

r the existence that zeta holds, and `nu(eta) = CN(z_ij; 0, sum_n E[r_n gamma_n] E[a_n a_n^H] + eta I)`. Given
existence the powers of the tones are independent in psi, and every factor reads one of them: they stay so.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.core.linalg import check_finite
from torchdt.core.weights import normalise, weighted_mean
from torchdt.filter.bp.moments import signal_covariance, signal_without_each, weighted_moment
from torchdt.filter.bp.rank_one import log_likelihood_ratio, statistics, whiten
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise, NoiseModel


class ToFactors(NamedTuple):
    """Messages from the variables to the J I factors; normalised log-weights of the variables' particles.

    Attributes:
        beta: `(*batch, J, N, I, P)` of the states.
        zeta: `(*batch, J, N, I, G)` of the power of the factor's tone given existence.
        log_odds: `(*batch, J, N, I)` of existence in zeta.
        iota: `(*batch, J, I, E)` of the noise variances.
    """

    beta: Tensor
    zeta: Tensor
    log_odds: Tensor
    iota: Tensor


class FromFactors(NamedTuple):
    """Logarithms of the messages from the J I factors, each up to a constant.

    Attributes:
        kappa: `(*batch, J, N, I, P)` to the states.
        lam: `(*batch, J, N, I, G)` lambda to the powers given existence, relative to that of no object.
        nu: `(*batch, J, I, E)` to the noise variances.
    """

    kappa: Tensor
    lam: Tensor
    nu: Tensor


def pass_messages(
    objects: Objects,
    response: Tensor,
    noise: Noise,
    measurement: Measurement,
    model: NoiseModel,
    iterations: int,
) -> tuple[Objects, Noise]:
    """Beliefs of one time step: the product of all messages that reach a variable.

    In each iteration all factors send at once, on what they were sent in the last; at first the predictions.

    Args:
        objects: predicted, batch `(*batch, N)`: alpha and psi.
        response: `(*batch, N, I, P, M)` complex responses of the particles.
        noise: predicted, batch `(*batch,)`: xi.
        measurement: statistics of the step, batch `(*batch,)`.
        model: of the noise: what a variance makes of the covariance of the data.
        iterations: number of times that messages go to the factors and back.

    Raises:
        NumericalError: where a covariance is not positive definite or a message not finite.
    """
    each = snapshots(measurement)
    # No factor has said anything yet.
    shape = (*each.num_snapshots.shape[:-1], *response.shape[-4:-1])
    back = FromFactors(
        objects.log_weight.new_zeros(shape),
        objects.log_weight.new_zeros(*shape[:-1], objects.power.shape[-1]),
        objects.log_weight.new_zeros(*each.num_snapshots.shape, noise.variance.shape[-1]),
    )
    for _ in range(iterations):
        to = to_factors(objects, noise, back)
        back = from_factors(objects.power, response, noise.variance, each, model, to)
    log_power_weight, gain = normalise(objects.log_power_weight + back.lam.sum(-4))
    beliefs = objects._replace(
        log_weight=normalise(objects.log_weight + back.kappa.sum((-4, -2)))[0],
        log_power_weight=log_power_weight,
        log_odds=objects.log_odds + gain.sum(-1),
    )
    return beliefs, noise._replace(log_weight=normalise(noise.log_weight + back.nu.sum(-3))[0])


def snapshots(measurement: Measurement) -> Measurement:
    """The snapshots of a step, one by one.

    Where only their scatter matrix is known, its factor's columns stand for them, each for as many as it
    takes: the product of all is the likelihood of the step either way.

    Args:
        measurement: batch `(*batch,)`, R columns a tone.

    Returns:
        Measurement of batch `(*batch, R)`, of one column a tone.
    """
    factor = measurement.factor.movedim(-1, -3)
    sent = factor.abs().square().sum(-1) > 0
    share = measurement.num_snapshots / sent.sum(-2).clamp_min(1)
    present = measurement.present.unsqueeze(-3).expand(factor.shape)
    return Measurement(factor.unsqueeze(-1), share.unsqueeze(-2) * sent, present)


def to_factors(objects: Objects, noise: Noise, back: FromFactors) -> ToFactors:
    """Predictions times what all factors but the one sent to say.

    Args:
        objects: predicted, batch `(*batch, N)`.
        noise: predicted, batch `(*batch,)`.
        back: latest messages from the factors.
    """
    state = (objects.log_weight + back.kappa.sum((-4, -2)))[..., None, :, None, :]
    power = objects.log_power_weight + back.lam.sum(-4)
    whole = normalise(power)[1]
    zeta, without = normalise(power.unsqueeze(-4) - back.lam)
    # A factor reads the power of its tone; of the other tones existence is all that reaches it.
    log_odds = objects.log_odds.unsqueeze(-1) + whole.sum(-1, keepdim=True) - whole
    iota = (noise.log_weight + back.nu.sum(-3)).unsqueeze(-3) - back.nu
    return ToFactors(
        normalise(state - back.kappa)[0], zeta, log_odds.unsqueeze(-3) + without, normalise(iota)[0]
    )


def from_factors(
    power: Tensor, response: Tensor, variance: Tensor, each: Measurement, model: NoiseModel, to: ToFactors
) -> FromFactors:
    """What every factor says of each variable, all others moment-matched.

    Args:
        power: `(*batch, N, I, G)` particles.
        response: `(*batch, N, I, P, M)` complex responses of the state particles.
        variance: `(*batch, I, E)` particles.
        each: single snapshots, batch `(*batch, J)`.
        model: of the noise.
        to: messages to the factors.

    Raises:
        NumericalError: where a covariance is not positive definite or a message not finite.
    """
    strength = torch.sigmoid(to.log_odds) * weighted_mean(power.unsqueeze(-4), to.zeta)
    shared = response.unsqueeze(-5)
    moment = weighted_moment(shared.unsqueeze(-3), to.beta.exp()).squeeze(-3)
    level = weighted_mean(variance.unsqueeze(-3), to.iota)
    per_object = each.unsqueeze()
    others = model.covariance(signal_without_each(strength, moment), level.unsqueeze(-2), per_object.present)
    whitener = whiten(per_object, others)
    s, q = statistics(whitener, shared)
    J = each.num_snapshots[..., None, None]
    kappa, lam = [], []
    # One object at a time: every power with every state is the largest tensor of all.
    for n in range(power.shape[-3]):
        powers = power[..., None, n, :, :, None]
        ratio = log_likelihood_ratio(J, powers, s[..., n, :, None, :], q[..., n, :, None, :])
        log_odds = to.log_odds[..., n, :, None]
        exists = torch.logsumexp(ratio + to.zeta[..., n, :, :, None], -2) + logsigmoid(log_odds)
        kappa.append(torch.logaddexp(logsigmoid(-log_odds), exists))
        lam.append(torch.logsumexp(ratio + to.beta[..., n, :, None, :], -1))
    silent = Noise(variance.unsqueeze(-3).expand(to.iota.shape), torch.zeros_like(to.iota))
    nu = model.update(silent, each, signal_covariance(strength, moment)).log_weight
    return FromFactors(
        check_finite(torch.stack(kappa, -3), "message kappa to the state"),
        check_finite(torch.stack(lam, -3), "message lambda to the power state"),
        check_finite(nu, "message nu to the noise variance"),
    )
