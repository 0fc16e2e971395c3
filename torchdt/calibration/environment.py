"""Calibrate a waveguide to a recording before tracking in it."""

import logging
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from scipy.stats import chi2
from torch import Generator, Tensor

from torchdt.calibration.focalise import focalise
from torchdt.calibration.share import mismatch_share
from torchdt.core.ranges import Checked, Count, InnerProbability, Passes, Positive, Steps
from torchdt.core.trees import tree_map
from torchdt.field.waveguide.family import WaveguideFamily
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.filter.proposal.dictionary import build_dictionary
from torchdt.filter.proposal.search import Picks, search
from torchdt.model.gamma_chain import uniform_prior
from torchdt.model.measurement import Measurement
from torchdt.model.noise.base import Noise
from torchdt.model.prior import Priors
from torchdt.model.region import Region

log = logging.getLogger(__name__)


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
    field = family.solve(theta)
    # Positions are found to a fraction of a cell; that is also how far a wrong environment moves them.
    scale = region.cell / 4
    share = torch.zeros_like(priors.noise_max)
    for _ in range(config.passes):
        picks = _detect(field, region, part, priors, config, stream)
        if picks is None:
            break
        start = (family.linearise(theta), family.prior_std, theta, picks.position, picks.active, part, scale)
        fitted = focalise(*start)
        fixed = focalise(*start, free_environment=False)
        gain = float(fitted.log_posterior - fixed.log_posterior)
        log.info(
            "environment fit gains %.1f nats, leaves %.2g of the energy", gain, float(fitted.leftover.mean())
        )
        significant = gain > 0.5 * chi2.isf(config.false_alarm, len(theta))
        if significant:
            theta = fitted.theta
            field = family.solve(theta)
        position = fitted.position if significant else fixed.position
        if config.share:
            share = mismatch_share(field, position, picks.active, part)
        if not significant:
            break
    return Calibration(theta, share)


def _detect(
    field: NormalModeField,
    region: Region,
    measurement: Measurement,
    priors: Priors,
    config: CalibrationConfig,
    stream: Generator,
) -> Picks | None:
    """Sources of each step by matching pursuit."""
    size = measurement.num_snapshots.shape[0]
    signal = torch.zeros_like(measurement.factor[..., :1] * measurement.factor[..., :1].mH)
    noise = Noise(*uniform_prior(priors.noise_max.expand(size, -1), 64))
    free = torch.full((size,), config.sources, device=signal.device)
    shape = (size, config.sources, 6, 128, region.num_coordinates)
    draws = torch.randn(shape, generator=stream, dtype=torch.float64, device=stream.device)
    dictionary = build_dictionary(field, region)
    with torch.no_grad():
        return search(
            field,
            region,
            dictionary,
            measurement,
            signal,
            noise,
            free,
            torch.full((size,), config.threshold, dtype=torch.float64, device=signal.device),
            draws.to(signal.device),
        )[0]
