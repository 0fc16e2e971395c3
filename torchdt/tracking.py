"""From a recording in any units to tracks in the same units."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from torchdt.config import TrackerConfig
from torchdt.errors import InputError
from torchdt.field.base import Field
from torchdt.history import TrackHistory
from torchdt.model.measurement import Measurement, from_covariance, from_snapshots
from torchdt.model.prior import Priors, data_priors, data_scale
from torchdt.model.region import Region
from torchdt.random import RandomStreams
from torchdt.scenario.recording import Recording
from torchdt.tracker import DirectTracker


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


def prepare(recording: Recording, field: Field, region: Region, config: TrackerConfig) -> Prepared:
    """Scale a recording and set the priors that the configuration leaves to the data.

    Args:
        recording: B sequences.
        field: what the tones and sensors of the recording must fit.
        region: gives type and device of the result.
        config: limits of the priors, where they are set.

    Raises:
        InputError: where tones or sensors differ from the field's, or a recording is zero throughout.
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
    if config.power_max is not None:
        priors = priors._replace(power_max=(config.power_max / unit).expand_as(priors.power_max))
    if config.noise_max is not None:
        priors = priors._replace(noise_max=(config.noise_max / unit).expand_as(priors.noise_max))
    return Prepared(measurement, priors, scale)


def track(
    recording: Recording,
    tracker: DirectTracker,
    seeds: Sequence[int],
    on_step: Callable[[int, TrackHistory], None] | None = None,
) -> TrackHistory:
    """Track every sequence of a recording, without gradients.

    Args:
        recording: B sequences.
        tracker: the tracker.
        seeds: one per sequence.
        on_step: called after each step with its index and estimates.

    Returns:
        History of batch `(B,)` with powers, noise and evidence in units of the recording.

    Raises:
        InputError: where the recording does not fit the field.
        NumericalError: where the filter broke down.
    """
    region = tracker.region
    prepared = prepare(recording, tracker.field, region, tracker.config)
    filter_seeds = [derive_seed(seed, "filter") for seed in seeds]
    streams = RandomStreams.from_seeds(
        filter_seeds, (recording.batch_size,), region.low.dtype, region.low.device
    )
    with torch.inference_mode():
        history = tracker.run(prepared.measurement, prepared.priors, streams, on_step)
    unit = prepared.scale.to(history.noise.device)
    square = unit.square().to(history.noise.dtype)
    measurement = prepared.measurement
    # The density of complex data z = unit * z' is that of z' over unit^2 for every complex entry.
    entries = (measurement.num_snapshots * measurement.present.sum(-1)).sum(-1)
    jacobian = 2 * entries.double() * unit.log()[:, None]
    return history._replace(
        power=history.power * square[:, None, None, None],
        noise=history.noise * square[:, None, None],
        log_evidence=history.log_evidence.double() - jacobian,
    )


def derive_seed(seed: int, purpose: str) -> int:
    """Seed of an independent stream for one purpose."""
    digest = hashlib.blake2b(f"{purpose}:{seed}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") & (2**63 - 1)


def generator(seed: int, purpose: str) -> Generator:
    """A CPU generator for one purpose."""
    return Generator().manual_seed(derive_seed(seed, purpose))
