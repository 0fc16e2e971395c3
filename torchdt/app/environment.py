"""Waveguides around the configured one: their family, and the member that fits a recording."""

import logging
from typing import Any

import torch

from torchdt.app.settings import TrackSettings
from torchdt.app.targets import build_field
from torchdt.calibration.environment import calibrate
from torchdt.core.errors import InputError
from torchdt.data.prepare import prepare
from torchdt.data.recording import Recording
from torchdt.field.base import BaseField
from torchdt.field.build import EnvironmentDraw
from torchdt.field.mismatch import MismatchedField
from torchdt.field.stacked import StackedField
from torchdt.field.waveguide.family import WaveguideFamily
from torchdt.field.waveguide.waveguide import NormalModeField
from torchdt.model.measurement import Measurement
from torchdt.model.prior import Priors
from torchdt.model.region import Region
from torchdt.run.track import generator

log = logging.getLogger(__name__)


def waveguide_family(settings: TrackSettings, target: dict[str, Any], dtype: torch.dtype) -> WaveguideFamily:
    """Waveguides by all that the calibration may fit.

    Args:
        settings: with the standard deviations of these.
        target: configuration of the nominal waveguide, with `eofs`.
        dtype: of the fields.
    """

    def solve(draw: EnvironmentDraw) -> NormalModeField:
        field = build_field(target, dtype, settings.device, draw=draw)
        assert isinstance(field, NormalModeField)
        return field

    config, sensors = settings.calibration, len(target["element_depths"])
    return WaveguideFamily(
        solve,
        [config.eof_std] * len(target["eofs"]["functions"][0]),
        config.tilt_std_deg,
        config.water_depth_std_m,
        settings.device,
        bow_std_m=config.bow_std_m,
        slope_std_m_per_km=config.slope_std_m_per_km,
        gain_std_db=[config.gain_std_db] * sensors,
        phase_std_deg=[config.phase_std_deg] * sensors,
    )


def calibrated_field(
    settings: TrackSettings, recording: Recording, target: dict[str, Any], nominal: BaseField, region: Region
) -> BaseField:
    """Fit the environment of each sequence; one field per sequence.

    Raises:
        InputError: where the field is no waveguide with EOFs.
    """
    config = settings.calibration
    if not isinstance(nominal, NormalModeField):
        raise InputError.of_key("calibration.enabled", True, "false: this field has no environment to fit")
    if target.get("eofs") is None:
        expected = "false (calibration=none), or sound-speed EOFs in field.eofs to fit the environment with"
        raise InputError.of_key("calibration.enabled", True, expected)
    family, track_family = (
        waveguide_family(settings, target, dtype) for dtype in (torch.float64, settings.torch_dtype)
    )
    region = Region(region.coordinates, torch.float64, settings.device)
    prepared = prepare(recording, nominal, region)
    fields = []
    for run in range(recording.batch_size):
        theta, share = calibrate(
            family,
            region,
            Measurement(*(t[run] for t in prepared.measurement)),
            Priors(*(t[run] for t in prepared.priors)),
            config,
            generator(settings.seed + run, "calibration"),
        )
        log.info("sequence %d: environment departs from nominal by %s", run, family.describe(theta))
        log.info("sequence %d: unexplained share of each tone %s", run, share.tolist())
        field = track_family.solve(theta) if theta.any() else nominal
        fields.append(MismatchedField(field, share.to(settings.torch_dtype)))
    if any(field.share.any() for field in fields):
        return StackedField(fields)
    plain = [field.field for field in fields]
    return nominal if all(field is nominal for field in plain) else StackedField(plain)
