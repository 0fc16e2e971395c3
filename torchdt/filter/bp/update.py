"""The BP update of a step: passes over all objects, the noise and what is no object."""

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.filter.bp.beliefs import Beliefs, as_belief, initial_beliefs
from torchdt.filter.bp.messages import ObjectBelief
from torchdt.filter.bp.moments import signal_covariance
from torchdt.filter.bp.schedule import SEQUENTIAL, Schedule
from torchdt.filter.interference.settings import NOTHING_ELSE, Interference, beside
from torchdt.filter.state import Objects
from torchdt.model.measurement import Measurement, gaussian_log_likelihood
from torchdt.model.noise.base import Noise, NoiseCovariance
from torchdt.model.noise.white import WHITE


def update(
    prior: Objects,
    response: Tensor,
    noise: Noise,
    measurement: Measurement,
    *,
    sweeps: int = 3,
    schedule: Schedule = SEQUENTIAL,
    initial: Beliefs | None = None,
    noise_model: NoiseCovariance = WHITE,
    interference: Interference = NOTHING_ELSE,
    before: Tensor | None = None,
) -> Beliefs:
    """BP update of one time step on fixed particles.

    Args:
        prior: predicted objects, batch `(*batch, N)`.
        response: `(*batch, N, I, P, M)` complex responses of the particles.
        noise: predicted noise.
        measurement: statistics of the step, batch `(*batch,)`.
        sweeps: passes over all objects; the noise is updated after each.
        schedule: order of the messages.
        initial: beliefs to start from; the predicted ones if None.
        noise_model: what the noise makes of the covariance of the data, without interferers.
        interference: what may be heard beside objects; those of `initial` are there from the start.
        before: `(*batch, I, M, K)` columns of the interferers of the last step; None for no place for any.

    Raises:
        NumericalError: where a covariance is not positive definite or a message not finite.
    """
    beliefs = initial_beliefs(prior, response, noise) if initial is None else initial
    heard = beside(noise_model, beliefs.interferers)
    for _ in range(sweeps):
        beliefs = schedule.sweep(prior, response, measurement, beliefs, heard, interference)
        signal = signal_covariance(beliefs.strength, beliefs.moment)
        if before is not None:
            found = interference.follow(measurement, noise_model, noise, signal, before, new=True)
            beliefs, heard = beliefs._replace(interferers=found), beside(noise_model, found)
        beliefs = beliefs._replace(noise=heard.update(noise, measurement, signal))
    return beliefs


@torch.no_grad()
def free_energy(
    beliefs: Beliefs, prior: Objects, measurement: Measurement, noise_model: NoiseCovariance
) -> Tensor:
    """`E log f(z | x, gamma, r) - KL(beliefs || prior)`, less what interferers cost, `(*batch,)`.

    A lower bound of the evidence were all beliefs independent and the first term exact; what objects send
    stands there as one Gaussian. It compares explanations of the same data.

    Args:
        beliefs: about objects, noise and interferers.
        prior: predicted objects.
        measurement: statistics of the step.
        noise_model: what the noise makes of the covariance of the data, without interferers.
    """
    signal = signal_covariance(beliefs.strength, beliefs.moment)
    heard = beside(noise_model, beliefs.interferers)
    covariance = heard.covariance(signal, beliefs.noise.mean, measurement.present)
    value = gaussian_log_likelihood(measurement, covariance).sum(-1) - divergence(
        beliefs.objects, as_belief(prior)
    )
    return value if beliefs.interferers is None else value - beliefs.interferers.cost.sum(-1)


def divergence(belief: ObjectBelief, prior: ObjectBelief) -> Tensor:
    """Kullback-Leibler divergence of beliefs about N objects from their prior, `(*batch,)`."""

    def relative(after: Tensor, before: Tensor) -> Tensor:
        """`sum p (log p - log q)`; nothing where p is zero."""
        return torch.where(after.isneginf(), 0.0, after.exp() * (after - before)).nan_to_num().sum(-1)

    there = torch.sigmoid(belief.log_odds)
    inside = relative(belief.log_weight, prior.log_weight)
    inside = inside + relative(belief.log_power_weight, prior.log_power_weight).sum(-1)
    yes = logsigmoid(belief.log_odds) - logsigmoid(prior.log_odds)
    no = logsigmoid(-belief.log_odds) - logsigmoid(-prior.log_odds)
    each = there * (yes + inside) + (1 - there) * no
    return torch.where(prior.log_odds.isneginf(), 0.0, each).sum(-1)
