"""What the points of one step say about potential objects.

F. Meyer, T. Kropfreiter, J. L. Williams, R. A. Lau, F. Hlawatsch, P. Braca and M. Z. Win, "Message passing
algorithms for scalable multitarget tracking", Proc. IEEE 106, 2018, Sec. IX, on particles. Both the points
themselves and the association between them and the objects are summed over; see `association`.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import logsigmoid

from torchdt.baselines.mot.association import associate
from torchdt.baselines.mot.config import PointConfig
from torchdt.core.linalg import check_finite


class Known(NamedTuple):
    """Known objects after a step.

    Attributes:
        log_weight: `(*batch, N, P)` normalised.
        log_odds: `(*batch, N)` of existence.
        taken: `(*batch, N, 1 + M)` p(a_n = m) of each point given existence, that of none first.
    """

    log_weight: Tensor
    log_odds: Tensor
    taken: Tensor


def update(
    log_weight: Tensor,
    log_odds: Tensor,
    log_likelihood: Tensor,
    new_log_likelihood: Tensor,
    log_clutter: Tensor,
    config: PointConfig,
) -> tuple[Known, Tensor]:
    """Beliefs about known and new objects.

    With the predicted existence r and particles of weight w_p,

        beta_n(m) = r p_D sum_p w_p f(z_m | x_p) / (mu_c f_c(z_m)),   beta_n(0) = 1 - r + r (1 - p_D),
        xi_m = 1 + mu_B int f(z_m | x) f_b(x) dx / (mu_c f_c(z_m)).

    A new object is one detected for the first time. As in the paper its term has no p_D: mu_B, the mean
    number of births, is taken for that of first detections, since hardly an object goes unseen for ever.

    Args:
        log_weight: `(*batch, N, P)` predicted, normalised.
        log_odds: `(*batch, N)` predicted, minus infinity for an empty slot.
        log_likelihood: `(*batch, N, M, P)` log f(z_m | x_p).
        new_log_likelihood: `(*batch, M)` log int f(z_m | x) f_b(x) dx.
        log_clutter: `(*batch, M)` log f_c(z_m); infinity for a point that is not there.
        config: numbers of the model.

    Returns:
        The known objects, and the log-odds `(*batch, M)` of a new object for each point.

    Raises:
        NumericalError: where a likelihood is NaN or infinite.
    """
    log_missed = math.log1p(-config.detection_probability)
    log_detected = math.log(config.detection_probability / config.clutter_mean) - log_clutter
    # Of every association by itself. A softmax of nothing but zero weights would be NaN.
    joint = (log_likelihood + log_weight.unsqueeze(-2)).clamp_min_(torch.finfo(log_weight.dtype).min)
    top = check_finite(joint.amax(-1), "likelihood of a point given a known object")
    posterior = joint.softmax(-1)
    detected = top - posterior.amax(-1).log() + log_detected.unsqueeze(-2)

    log_exists = logsigmoid(log_odds)
    undetected = torch.logaddexp(logsigmoid(-log_odds), log_exists + log_missed)
    legacy = torch.cat([undetected.unsqueeze(-1), log_exists.unsqueeze(-1) + detected], -1)
    log_new = check_finite(new_log_likelihood, "likelihood of a point given a new object")
    log_new = log_new + math.log(config.birth_mean / config.clutter_mean) - log_clutter
    messages = associate(legacy, _log_one_plus(log_new), config.tolerance, config.iterations)

    missed = torch.full_like(log_odds, log_missed).unsqueeze(-1)
    terms = torch.cat([missed, detected + messages.to_object], -1)
    taken = terms.softmax(-1)
    # Given existence the belief is the mixture of all associations. Of normalised log-weights the softmax is
    # the exponential, and the faster one where weights underflow.
    weight = (taken[..., 1:].unsqueeze(-2) @ posterior).squeeze(-2)
    weight.addcmul_(taken[..., :1], log_weight.softmax(-1))
    known = Known(weight.log_(), log_odds + terms.logsumexp(-1), taken)
    return known, log_new - _log_one_plus(messages.to_new)


def _log_one_plus(log_value: Tensor) -> Tensor:
    """Log(1 + e^x), to all digits."""
    return torch.logaddexp(torch.zeros_like(log_value), log_value)
