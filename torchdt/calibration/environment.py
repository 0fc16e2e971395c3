"""Calibrate a waveguide to a recording before tracking in it."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Generator, Tensor

from torchdt.calibration.detect import Detections, detect
from torchdt.calibration.focalise import Focus, focalise
from torchdt.calibration.share import mismatch_share
from torchdt.calibration.stages import Fit, select
from torchdt.core.ranges import Checked, Count, InnerProbability, NotNegative, Passes, Positive, Steps
from torchdt.core.trees import tree_map
from torchdt.field.base import BaseField
from torchdt.field.waveguide.family import WaveguideFamily
from torchdt.field.waveguide.mirage import MirageField, apparent_position, true_position
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors
from torchdt.model.region import Region


@dataclass
class CalibrationConfig(Checked):
    """How the environment is fitted.

    Attributes:
        enabled: fit it at all.
        steps: number of time steps used, evenly spread.
        sources: sources per step used, at most.
        passes: of detecting sources in the fitted environment and fitting again.
        threshold: log-likelihood ratio in nats that a source must reach to be used.
        share: also estimate which share of each tone the fitted environment still does not cover.
        false_alarm: probability of leaving the nominal environment where it is the true one.
        eof_std: prior standard deviation of each sound-speed EOF coefficient.
        tilt_std_deg, water_depth_std_m: prior standard deviations of array tilt and water depth.
        bow_std_m: of the bow of the array; zero keeps it at its nominal value.
        slope_std_m_per_km: of the slope of the bottom; likewise.
        gain_std_db, phase_std_deg: of gain and phase of each sensor, alike in all tones; likewise.
    """

    KEY: ClassVar[str] = "calibration"

    enabled: bool = True
    steps: Steps = 24
    sources: Count = 3
    passes: Passes = 2
    threshold: Positive = 14.5
    share: bool = True
    false_alarm: InnerProbability = 1e-5
    eof_std: Positive = 1.0
    tilt_std_deg: Positive = 1.0
    water_depth_std_m: Positive = 1.0
    bow_std_m: NotNegative = 2.0
    slope_std_m_per_km: NotNegative = 3.0
    gain_std_db: NotNegative = 1.0
    phase_std_deg: NotNegative = 10.0


class Calibration(NamedTuple):
    """Environment of one recording.

    Attributes:
        theta: `(T,)` float64 parameters; all zero is the nominal environment.
        share: `(I,)` float64 share of each tone's energy that responses in it do not cover.
    """

    theta: Tensor
    share: Tensor


def calibrate(
    family: WaveguideFamily,
    region: Region,
    measurement: Measurement,
    priors: Priors,
    config: CalibrationConfig,
    stream: Generator,
) -> Calibration:
    """Fit the environment of one recording.

    Sources are detected in the present environment in a few steps of the recording, then environment and
    positions are fitted together. The nominal environment stays where the fit does not improve on it by
    more than chance would.

    Args:
        family: environments.
        region: of interest, float64.
        measurement: statistics of batch `(K,)`, complex128.
        priors: without batch.
        config: settings.
        stream: random numbers for refining detections.

    Returns:
        What was found; the nominal environment where no source was.
    """
    num_steps = measurement.num_snapshots.shape[0]
    theta, count = torch.zeros_like(family.prior_std), min(config.steps, num_steps)
    chosen = torch.linspace(0, num_steps - 1, count, dtype=theta.dtype, device=theta.device).round().long()
    part = tree_map(lambda t: t[chosen], measurement)
    groups, kept = family.groups, tuple[str, ...]()
    field: BaseField = family.solve(theta)
    share = torch.zeros_like(priors.noise_max)
    for _ in range(config.passes):
        picks = detect(field, region, part, priors, config.sources, config.threshold, stream)
        if picks is None:
            break
        fitted, kept = select(_fit(family, region, theta, picks, part), groups, config.false_alarm, kept)
        theta = fitted.theta
        if kept:
            field = family.solve(theta)
        if config.share:
            share = mismatch_share(field, fitted.position, picks.active, part)
        if not kept:
            break
    return Calibration(theta, share)


def _fit(
    family: WaveguideFamily, region: Region, theta: Tensor, picks: Detections, measurement: Measurement
) -> Fit:
    """Fits around theta from the picks on."""
    # Positions are found to a fraction of a cell; that is also how far a wrong environment moves them.
    scale = region.cell / 4

    def steepness(values: Tensor) -> Tensor:
        return family.part(values, "slope_m_per_km").sum() / (1000 * family.water_depth)

    def fit(free: Tensor, start: Focus | None) -> Focus:
        values, position = (theta, picks.position) if start is None else (start.theta, start.position)
        begin = torch.where(free, values, 0.0)
        fields = family.linearise(begin, free)
        # A slope moves what is seen; what is left for the fit are the details.
        seen = apparent_position(position, steepness(values))
        found = focalise(
            lambda t: MirageField(fields(t), steepness(t)),
            family.prior_std,
            begin,
            seen,
            picks.active,
            measurement,
            scale,
            free,
        )
        return found._replace(position=true_position(found.position, steepness(found.theta)))

    return fit
