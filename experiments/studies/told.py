"""The bound of detection: a filter that is told track, power and noise, and asks whether the source is there.

Existence is then a Markov chain of two states, and its filter is exact: nothing that has to find track, power
and noise by itself can be better in the mean.
"""

import torch
from torch import Tensor

from torchdt.field.base import Field
from torchdt.filter.bp.rank_one import log_likelihood_ratio, statistics, whiten
from torchdt.model.measurement import from_snapshots


def track_evidence(snapshots: Tensor, field: Field, track: Tensor, power: Tensor, noise: float) -> Tensor:
    """Evidence of every step for a source on a track, against noise alone, in nats.

    Args:
        snapshots: `(B, K, I, J, M)` complex.
        field: array response.
        track: `(B, K, d)` positions.
        power: `(B,)` of the source, in squared units of the snapshots.
        noise: variance per sensor, in the same units.

    Returns:
        `(B, K)`: `log CN(z; 0, gamma a a^H + eta I) - log CN(z; 0, eta I)`, over all tones and snapshots.
    """
    measurement = from_snapshots(snapshots)
    eye = torch.eye(field.num_sensors, dtype=snapshots.dtype, device=snapshots.device)
    background = (noise * eye).expand(*measurement.num_snapshots.shape, -1, -1)
    s, q = statistics(whiten(measurement, background), field(track).unsqueeze(-2))
    J = measurement.num_snapshots[..., None]
    return log_likelihood_ratio(J, power[:, None, None, None], s, q)[..., 0].sum(-1)


def told_log_odds(evidence: Tensor, survival: float, birth: float) -> Tensor:
    """Log-odds of existence after every step.

    What is there goes on with p_s, and what is not begins with p_B: the model's, with all places of birth on
    the track.

    Args:
        evidence: `(*batch, K)` of the source if it is there in that step, nats.
        survival: p_s.
        birth: p_B, in the first step as in all others.

    Returns:
        `(*batch, K)`.
    """
    existence, steps = torch.zeros_like(evidence[..., 0]), []
    for nats in evidence.unbind(-1):
        predicted = survival * existence + birth * (1 - existence)
        steps.append(torch.logit(predicted) + nats)
        existence = torch.sigmoid(steps[-1])
    return torch.stack(steps, -1)
