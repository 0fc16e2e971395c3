"""From a recording in any units to data of order one, and priors that fit them."""

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from torchdt.core.errors import InputError, require
from torchdt.data.recording import Recording
from torchdt.field.base import Field
from torchdt.model.measurement import Measurement, from_covariance, from_snapshots
from torchdt.model.prior import Priors, data_priors, data_scale
from torchdt.model.region import Region

LARGEST = 1e150
"""Root mean square of data up to which, and from whose inverse on, powers are numbers in double precision."""

FAR = 1e30
"""Factor between a limit of a prior and the mean square of the data that single precision can still bear."""


class Limits(Protocol):
    """Limits of the priors in squared data units, as the settings of a tracker have them.

    Attributes:
        power_max: of the power of a new object; None takes it from the data.
        noise_max: of the noise variance before the first step; None takes it from the data.
    """

    power_max: float | None
    noise_max: float | None


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


def require_step(step_s: float) -> float:
    """The time step of a tracker, seconds.

    Raises:
        InputError: where it is no positive number.
    """
    number = isinstance(step_s, int | float) and not isinstance(step_s, bool)
    require(number and 0 < step_s < math.inf, "step_s", step_s, "a positive number of seconds")
    return step_s


def check_step(recording: Recording, step_s: float) -> None:
    """Refuse a recording whose steps are not of the tracker's length."""
    alike = math.isclose(recording.step_s, step_s, rel_tol=1e-6)
    require(alike, "step_s", f"{step_s} s in the tracker", f"{recording.step_s} s, as in the recording")


def prepare(
    recording: Recording,
    field: Field,
    region: Region,
    limits: Limits | None = None,
    effective_count: Tensor | float | None = None,
) -> Prepared:
    """Scale a recording and set the priors that the configuration leaves to the data.

    Args:
        recording: B sequences.
        field: what the tones and sensors of the recording must fit.
        region: gives type and device of the result.
        limits: of the priors, where they are set; None takes them from the data.
        effective_count: what every sample covariance is to count as; None leaves it to the data.

    Raises:
        InputError: where tones or sensors differ from the field's, a recording is zero throughout or so small
            or large that its powers do not exist in double precision, a configured limit is too far from the
            data, or an effective count is configured for snapshots, whose number is known.
    """
    data_key = "snapshots" if recording.covariance is None else "covariance"
    for size, found, fit in (
        ("tones", recording.num_tones, field.num_tones),
        ("sensors", recording.num_sensors, field.num_sensors),
    ):
        require(found == fit, data_key, f"{found} {size}", f"{fit} {size}, as the field has")
    data = recording.data.to(torch.complex128)
    is_covariance = recording.covariance is not None
    if effective_count is not None:
        key, count = "model.effective_count", float(torch.as_tensor(effective_count).min())
        require(is_covariance, key, count, "null: the data are snapshots")
        least = field.num_sensors - 1
        require(count > least, key, count, f"above {least} with these sensors")
    scale = data_scale(data, is_covariance)
    for value in scale[(scale <= 1 / LARGEST) | (scale >= LARGEST)].tolist()[:1]:
        expected = f"one from {1 / LARGEST:g} to {LARGEST:g}, whose square double precision can hold"
        raise InputError.of_key(data_key, f"a root mean square of {value:.3g}", expected)
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
    for name in priors._fields:
        limit = None if limits is None else getattr(limits, name)
        if limit is not None:
            like: Tensor = getattr(priors, name)
            priors = priors._replace(**{name: _in_units(name, limit, scale).to(like).expand_as(like)})
    return Prepared(measurement, priors, scale)


def _in_units(key: str, limit: float, scale: Tensor) -> Tensor:
    """A limit of a prior in squared units of the data, `(B, 1)` float64."""
    square = scale.square()
    relative = limit / square
    for value in square[(relative <= 1 / FAR) | (relative >= FAR)].tolist()[:1]:
        expected = f"a number within a factor of {FAR:g} of the mean square of the data, {value:.3g}"
        raise InputError.of_key(f"tracker.{key}", limit, expected)
    return relative[:, None]
