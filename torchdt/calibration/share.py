"""How much of each tone the fitted environment still leaves unexplained in the manner of a mismatch."""

import torch
from torch import Tensor

from torchdt.core.trees import tree_map
from torchdt.field.base import BaseField
from torchdt.filter.interference.signatures import free_gains, price
from torchdt.model.measurement import Measurement, gaussian_log_likelihood, mask_covariance

SHARES = (0.0, 0.001, 0.003, 0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.5, 0.7)
NOISE_DECADES, NOISE_POINTS = 5.0, 26


def mismatch_share(field: BaseField, position: Tensor, active: Tensor, measurement: Measurement) -> Tensor:
    """Maximum-likelihood share eps of each tone, over a grid, noise variance profiled out.

    The covariance of a step is `sum_n gamma_n [(1 - eps) a_n a_n^H + eps R(x_n)] + eta I` with powers from
    least squares; eps and eta are common to the steps. Beside it there may be a signal of free signature, at
    its price (`torchdt.filter.interference.signatures`): what is no source raises no share.

    Args:
        field: fitted field.
        position: `(S, N, d)` fitted source positions.
        active: `(S, N)` bool.
        measurement: statistics of batch `(S,)`.

    Returns:
        `(I,)` real.
    """
    response = field(position) * measurement.present.unsqueeze(-3)
    columns = (response * active[..., None, None]).permute(0, 2, 3, 1)
    ridge = 1e-6 * torch.eye(columns.shape[-1], dtype=columns.dtype, device=columns.device)
    amplitude = torch.linalg.solve(columns.mH @ columns + ridge, columns.mH @ measurement.factor)
    power = amplitude.abs().square().sum(-1) / measurement.num_snapshots.clamp_min(1.0)[..., None]
    power = power.transpose(-1, -2)[..., None, None]
    coherent = (power * response[..., :, None] * response[..., None, :].conj()).sum(1)
    scattered = (power * field.incoherent(position)).sum(1)
    level = measurement.energy.mean(0) / measurement.factor.shape[-2]
    steps = torch.linspace(-NOISE_DECADES, 0.0, NOISE_POINTS, dtype=level.dtype, device=level.device)
    noise = level.clamp_min(torch.finfo(level.dtype).tiny) * 10 ** steps[:, None]
    per_noise = tree_map(lambda t: t[:, None], measurement)
    cost = price(per_noise, noise)
    scores, heard = [], []
    for share in SHARES:
        signal = (1 - share) * coherent + share * scattered
        covariance = mask_covariance(signal[:, None], noise.expand(len(position), -1, -1), per_noise.present)
        beside = free_gains(per_noise, covariance, 1)[..., 0] - cost
        scores.append(gaussian_log_likelihood(per_noise, covariance) + beside.clamp_min(0))
        heard.append(beside > 0)
    score = torch.stack(scores)  # of shares, steps, noise levels and tones
    total, level_of = score.sum(1).max(1)
    best = total.argmax(0)
    # Few modes at low tones explain also what is no source: steps are judged by all tones together.
    tone = torch.arange(score.shape[-1], device=best.device)
    interfered = torch.stack(heard)[best, :, level_of[best, tone], tone].double().mean(0) > 0.5
    best = (score * ~interfered[:, None, None]).sum(1).amax(1).argmax(0)
    return torch.tensor(SHARES, dtype=level.dtype, device=level.device)[best]
