"""Messages between one object and the measurement factors of all tones.

The nodes are (x, r) and, given existence, one power per tone. A single object with known noise is then
a tree and its belief exact. Message to the state: average over gamma; to gamma: average over x; to
existence: over both. All in logarithms.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.linalg import check_finite
from torchdt.core.weights import normalise
from torchdt.filter.bp.rank_one import Whitener, log_likelihood_ratio, statistics


class ObjectBelief(NamedTuple):
    """Belief about one object (or a batch of them) on fixed support points.

    Attributes:
        log_weight: `(*batch, P)` of the state particles given existence.
        log_power_weight: `(*batch, I, G)` of the power points given existence.
        log_odds: `(*batch,)` of existence.
    """

    log_weight: Tensor
    log_power_weight: Tensor
    log_odds: Tensor


def state_message(whitener: Whitener, response: Tensor, power: Tensor, log_power_weight: Tensor) -> Tensor:
    """Log-likelihood ratio of each particle, powers averaged out: the messages of all tones multiplied.

    Args:
        whitener: of batch `(*batch,)`.
        response: `(*batch, I, P, M)` complex.
        power, log_power_weight: `(*batch, I, G)` power belief.

    Returns:
        `(*batch, P)`.
    """
    return _tone_messages(whitener, response, power, log_power_weight)[0].sum(-2)


def object_belief(whitener: Whitener, response: Tensor, power: Tensor, prior: ObjectBelief) -> ObjectBelief:
    """Belief of one object from its prior and the messages of all tones.

    Args:
        whitener: background without this object, batch `(*batch,)`.
        response: `(*batch, I, P, M)` complex responses of the particles.
        power: `(*batch, I, G)` support points of the powers.
        prior: predicted belief.

    Raises:
        NumericalError: where a message is NaN or infinite.
    """
    message, likelihood, total = _tone_messages(whitener, response, power, prior.log_power_weight)
    posterior = prior.log_weight + check_finite(message, "message to the object state").sum(-2)
    log_weight, log_evidence = normalise(posterior)
    # What the other tones say of x times this tone's likelihood: a mean over the particles of how likely
    # each makes the powers. A weight that underflows stays one, so that its logarithm has a derivative.
    weight = log_weight.exp()[..., None, :] / total
    power_weight = (likelihood * weight[..., None, :]).sum(-1).clamp_min(torch.finfo(weight.dtype).tiny)
    log_power_weight, _ = normalise(power_weight.log())
    return ObjectBelief(log_weight, log_power_weight, prior.log_odds + log_evidence)


def _tone_messages(
    whitener: Whitener, response: Tensor, power: Tensor, log_power_weight: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Messages `(*batch, I, P)`, and what they are logarithms of but for a factor for each particle.

    Returns:
        The messages; weight times likelihood ratio of every power, over their largest, `(*batch, I, G, P)`;
        its sum over the powers, `(*batch, I, P)`.
    """
    s, q = statistics(whitener, response)
    J = whitener.num_snapshots[..., None, None]
    # Powers before particles: what runs over the few powers is then a sum of long rows.
    joint = log_likelihood_ratio(
        J, power[..., None], s[..., None, :], q[..., None, :], log_power_weight[..., None]
    )
    top = joint.detach().amax(-2, keepdim=True)
    likelihood = (joint - top).exp_()
    total = likelihood.sum(-2)
    return total.log() + top.squeeze(-2), likelihood, total
