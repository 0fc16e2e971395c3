"""Messages between one object and the measurement factors of all tones.

The nodes are (x, r) and, given existence, one power per tone. A single object with known noise is then
a tree and its belief exact. Message to the state: average over gamma; to gamma: average over x; to
existence: over both. All in logarithms.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.bp.rank_one import Whitener, log_likelihood_ratio, statistics
from torchdt.linalg import check_finite
from torchdt.particles.weights import normalise


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
    message, log_ratio = _tone_messages(whitener, response, power, prior.log_power_weight)
    posterior = prior.log_weight + check_finite(message, "message to the object state").sum(-2)
    log_weight, log_evidence = normalise(posterior)
    # sum_p w_p exp(ell_pg - message_p): what the other tones say of x, times this tone's likelihood.
    shifted = log_weight[..., None, :, None] + log_ratio - message[..., None]
    log_power_weight, _ = normalise(prior.log_power_weight + torch.logsumexp(shifted, -2))
    return ObjectBelief(log_weight, log_power_weight, prior.log_odds + log_evidence)


def _tone_messages(
    whitener: Whitener, response: Tensor, power: Tensor, log_power_weight: Tensor
) -> tuple[Tensor, Tensor]:
    """Messages `(*batch, I, P)` and the log-likelihood ratios `(*batch, I, P, G)` behind them."""
    s, q = statistics(whitener, response)
    J = whitener.num_snapshots[..., None, None]
    log_ratio = log_likelihood_ratio(J, power[..., None, :], s[..., None], q[..., None])
    return torch.logsumexp(log_power_weight[..., None, :] + log_ratio, -1), log_ratio
