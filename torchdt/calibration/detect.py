"""Sources of single steps, found by matching pursuit, beside what may be no source.

The loudest signal of a step may come from outside the region, where no response fits it: sources are then
sought in its place, and what is really there drowns. So there are two searches, one of them beside the
strongest signal of free signature in each tone, and each step keeps the one that explains it better.
"""

from typing import NamedTuple

import torch
from torch import Generator, Tensor

from torchdt.calibration.focalise import explanations, leftover
from torchdt.field.base import BaseField
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.filter.proposal.search import search
from torchdt.model.gamma_chain import uniform_prior
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise
from torchdt.model.prior import Priors
from torchdt.model.region import Region


class Detections(NamedTuple):
    """Sources of each step.

    Attributes:
        position: `(S, N, d)`.
        active: `(S, N)` bool, which of them there are.
    """

    position: Tensor
    active: Tensor


@torch.no_grad()
def detect(
    field: BaseField,
    region: Region,
    measurement: Measurement,
    priors: Priors,
    sources: int,
    threshold: float,
    stream: Generator,
) -> Detections | None:
    """Sources of each step; None where there is none in any.

    Args:
        field: in which they are sought.
        region: of interest, float64.
        measurement: statistics of batch `(S,)`, complex128.
        priors: without batch.
        sources: N, per step at most.
        threshold: log-likelihood ratio in nats that each must reach.
        stream: random numbers for refining them.
    """
    size = measurement.num_snapshots.shape[0]
    noise = Noise(*uniform_prior(priors.noise_max.expand(size, -1), 64))
    like = measurement.num_snapshots
    free = torch.full((size,), sources, device=like.device)
    least = torch.full((size,), threshold, dtype=torch.float64, device=like.device)
    shape = (size, sources, 6, 128, region.num_coordinates)
    draws = torch.randn(shape, generator=stream, dtype=torch.float64, device=stream.device).to(like.device)
    dictionary = build_dictionary(field, region)

    def found_beside(signal: Tensor) -> Detections:
        picks = search(field, region, dictionary, measurement, signal, noise, free, least, draws)[0]
        if picks is not None:
            return Detections(picks.position, picks.active)
        nowhere = region.lower_end.expand(size, 1, -1)
        return Detections(nowhere, torch.zeros(size, 1, dtype=torch.bool, device=like.device))

    column = strongest(measurement)
    first = found_beside(0 * column @ column.mH)
    plain, with_signal = _explained(field, first, measurement)
    if bool((with_signal > plain).any()):
        second = found_beside(column @ column.mH)
        gain = torch.maximum(*_explained(field, second, measurement)).sum(-1)
        gain = gain - torch.maximum(plain, with_signal).sum(-1)
        more = second.active.sum(-1) - first.active.sum(-1)
        first = _either(gain > threshold * more, second, first)
    return first if bool(first.active.any()) else None


def strongest(measurement: Measurement) -> Tensor:
    """The strongest signal of each step and tone, `(S, I, M, 1)`: signature times the root of the power."""
    vector, value, _ = torch.linalg.svd(measurement.factor, full_matrices=False)
    root = value[..., :1] / measurement.num_snapshots.clamp_min(1.0).sqrt()[..., None]
    return vector[..., :1] * root[..., None, :]


def _explained(field: BaseField, found: Detections, measurement: Measurement) -> tuple[Tensor, Tensor]:
    shares = leftover(field(found.position), found.active, measurement)
    return explanations(*shares, found.active, measurement)


def _either(chosen: Tensor, one: Detections, other: Detections) -> Detections:
    """One of two in each step, `(S,)` bool."""
    number = max(one.active.shape[-1], other.active.shape[-1])
    parts = []
    for found in (one, other):
        missing = number - found.active.shape[-1]
        position = torch.cat([found.position, found.position[:, :1].expand(-1, missing, -1)], 1)
        active = torch.cat([found.active, found.active.new_zeros(len(chosen), missing)], 1)
        parts.append((position, active))
    (position, active), (position2, active2) = parts
    return Detections(
        torch.where(chosen[:, None, None], position, position2), torch.where(chosen[:, None], active, active2)
    )
