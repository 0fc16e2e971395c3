"""Scale of the data and the priors that follow from it."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchdt.core.errors import InputError
from torchdt.model.measurement import Measurement


class Priors(NamedTuple):
    """Upper limits of the uniform priors, in squared units of the data.

    Attributes:
        power_max: `(*batch, I)` of the transmit power of a new object.
        noise_max: `(*batch, I)` of the noise variance before the first step, at k = 0.
    """

    power_max: Tensor
    noise_max: Tensor


def data_scale(data: Tensor, is_covariance: bool) -> Tensor:
    """Root-mean-square value of the data of each sequence, for bringing them to order one.

    Args:
        data: snapshots `(*batch, K, I, J, M)` or covariances `(*batch, K, I, M, M)`; NaN is missing.
        is_covariance: which of the two.

    Returns:
        `(*batch,)` real, positive; 1 where everything is missing.

    Raises:
        InputError: where a sequence is zero throughout.
    """
    power = data.diagonal(dim1=-2, dim2=-1).real if is_covariance else data.abs()
    # Dividing by the largest magnitude first keeps the squares of tiny or huge units representable.
    largest = power.nan_to_num(nan=0.0).flatten(-4 + is_covariance).amax(-1)
    observed = (~power.isnan()).flatten(-4 + is_covariance).any(-1)
    if bool((observed & (largest <= 0)).any()):
        raise InputError.of_key(
            "covariance" if is_covariance else "snapshots", "only zeros", "a signal or noise"
        )
    largest = torch.where(observed, largest, 1.0)
    relative = power / largest.reshape(*largest.shape, *(1 for _ in range(power.ndim - largest.ndim)))
    square = relative if is_covariance else relative.square()
    mean = square.flatten(-4 + is_covariance).nanmean(-1)
    mean = torch.where(observed, mean, 1.0)
    return (largest * mean).sqrt() if is_covariance else largest * mean.sqrt()


def data_priors(measurement: Measurement) -> Priors:
    """Limits that cover what was received, from the quantiles of the energy over time.

    The strongest object is hardly above the energy per snapshot of the loudest steps, and the noise
    variance hardly above the usual energy per sensor; both limits are twice that. Quantiles keep a
    single wild step from setting the prior.

    Args:
        measurement: statistics of whole sequences, batch `(*batch, K)`.
    """
    observed = measurement.num_snapshots > 0
    energy = torch.where(observed, measurement.energy, torch.nan)
    per_sensor = energy / measurement.present.sum(-1).clamp_min(1.0)
    power = 2 * energy.nanquantile(0.99, dim=-2)
    noise = 2 * per_sensor.nanquantile(0.5, dim=-2)
    tiny = torch.finfo(power.dtype).eps
    # A tone without data has no influence; any positive limit serves.
    return Priors(power.nan_to_num(nan=1.0).clamp_min(tiny), noise.nan_to_num(nan=1.0).clamp_min(tiny))


def resolvable_noise(measurement: Measurement, priors: Priors) -> Tensor:
    """Noise variance below which numbers of this precision cannot tell it from rounding, `(*batch, I)`.

    What was received is known to its rounding error, and so is what objects explain of it: `eps` times the
    energy per snapshot of the step. In silence, it is that of the usual energy of a sensor.

    Args:
        measurement: statistics of one step, batch `(*batch,)`.
        priors: limits of the priors.
    """
    usual = priors.noise_max.detach()
    return torch.finfo(usual.dtype).eps * torch.maximum(measurement.energy.detach().to(usual), usual)
