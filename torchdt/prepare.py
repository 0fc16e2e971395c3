"""From a recording in any units to data of order one, and priors that fit them."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchdt.config import TrackerConfig
from torchdt.errors import InputError, require
from torchdt.field.base import Field
from torchdt.model.measurement import Measurement, from_covariance, from_snapshots
from torchdt.model.prior import Priors, data_priors, data_scale
from torchdt.model.region import Region
from torchdt.scenario.recording import Recording


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording as the tracker takes it: brought to order one, with priors.

    Attributes:
        measurement: statistics of batch `(B, K)` in units of `scale`.
        priors: in squared units of `scale`.
        scale: `(B,)` float64, data units.
    """

    measurement: Measurement
    priors: Priors
    scale: Tensor


def prepare(
    recording: Recording, field: Field, region: Region, config: TrackerConfig | None = None
) -> Prepared:
    """Scale a recording and set the priors that the configuration leaves to the data.

    Args:
        recording: B sequences.
        field: what the tones and sensors of the recording must fit.
        region: gives type and device of the result.
        config: limits of the priors, where they are set; None takes them from the data.

    Raises:
        InputError: where tones or sensors differ from the field's, a recording is zero throughout, or an
            effective count is configured for snapshots, whose number is known.
    """
    for key, found, expected in (
        ("tones", recording.num_tones, field.num_tones),
        ("sensors", recording.num_sensors, field.num_sensors),
    ):
        if found != expected:
            name = "snapshots" if recording.covariance is None else "covariance"
            raise InputError.of_key(name, f"{found} {key}", f"{expected} {key}, as the field has")
    data = recording.data.to(torch.complex128)
    is_covariance = recording.covariance is not None
    count = None if config is None else config.effective_count
    require(is_covariance or count is None, "tracker.effective_count", count, "null: the data are snapshots")
    scale = data_scale(data, is_covariance)
    # Scaled in double and then rounded: the same numbers whatever unit the file is in.
    divisor = scale.square() if is_covariance else scale
    scaled = (data / divisor[:, None, None, None, None]).to(
        torch.complex64 if region.low.dtype == torch.float32 else torch.complex128
    )
    scaled = scaled.to(region.low.device)
    if is_covariance:
        assert recording.num_snapshots is not None
        measurement = from_covariance(scaled, recording.num_snapshots)
    else:
        measurement = from_snapshots(scaled)
    priors = data_priors(measurement)
    unit = scale.square().to(priors.power_max)[:, None]
    if config is not None and config.power_max is not None:
        priors = priors._replace(power_max=(config.power_max / unit).expand_as(priors.power_max))
    if config is not None and config.noise_max is not None:
        priors = priors._replace(noise_max=(config.noise_max / unit).expand_as(priors.noise_max))
    return Prepared(measurement, priors, scale)
